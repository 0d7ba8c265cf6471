"""The paper's network (figure 2): two convolutions over the rays, a dense layer, a head."""

from __future__ import annotations

from dataclasses import dataclass
import math

from shepherd_ros.config import Config, ConfigError, option
from shepherd_ros.policy.fast_conv import first_stage, plain_stage, POOL_SIZE, second_stage
import torch
from torch import nn, Tensor
from torch.nn import functional

KERNEL_SIZE = 10  # rays that a filter covers


@dataclass(frozen=True)
class NetworkConfig(Config):
    """The sizes of the network, by default the paper's."""

    filters_1: int = option(32, 'filters of the first convolution', low=1, high=1024)
    filters_2: int = option(64, 'filters of the second convolution', low=1, high=1024)
    hidden: int = option(512, 'units of the dense layer', low=1, high=16384)
    padding: str = option(
        'valid',
        'valid: as the paper counts; circular: rays close to a ring, for layout ring only',
        choices=('valid', 'circular'),
    )
    std_type: str = option(
        'state',
        'standard deviation of actions: state: two more outputs (paper); free: two numbers',
        choices=('state', 'free'),
    )
    init_std: float = option(0.6, 'standard deviation before training [m/s]', low=0.001)
    modes: int = option(
        1,
        'modes of an action: 1; or 2, drive and hold, each with a mean, and a gate that chooses',
        low=1,
        high=2,
        sparse=True,
    )
    min_std: float = option(0.05, 'smallest standard deviation [m/s]', low=0.0001)
    max_std: float = option(1.65, 'largest standard deviation [m/s]', low=0.001)


def fast_dtype(device: torch.device | None = None) -> torch.dtype:
    """Return bfloat16 if the device (None: the CPU) has matrix products of it, else float32."""
    if device is not None and device.type == 'cuda':
        return torch.bfloat16
    has_products = torch.cpu._is_amx_tile_supported() or torch.cpu._is_avx512_bf16_supported()
    return torch.bfloat16 if has_products else torch.float32


def weights(layer: nn.Conv1d) -> tuple[Tensor, Tensor]:
    """Return weight (F, C, K) and bias (F) of a convolution."""
    assert layer.bias is not None
    return layer.weight, layer.bias


class Body(nn.Module):
    """Layers from input (B, D, L) to features (B, hidden), of actor and critic alike."""

    def __init__(self, shape: tuple[int, int], config: NetworkConfig) -> None:
        """Create the layers for an input of shape (D, L)."""
        super().__init__()
        channels, length = shape
        self.circular = config.padding == 'circular'
        for _ in range(2):
            length = (length if self.circular else length - KERNEL_SIZE + 1) // POOL_SIZE
        if length < 1:
            raise ConfigError(f'an input of {shape[1]} values in a row: expected 79 or more')
        self.conv1 = nn.Conv1d(channels, config.filters_1, KERNEL_SIZE)
        self.conv2 = nn.Conv1d(config.filters_1, config.filters_2, KERNEL_SIZE)
        self.dense = nn.Linear(length * config.filters_2, config.hidden)
        for layer in (self.conv1, self.conv2, self.dense):
            nn.init.orthogonal_(layer.weight.flatten(1), math.sqrt(2.0))
            assert layer.bias is not None
            nn.init.zeros_(layer.bias)

    def forward(self, x: Tensor) -> Tensor:
        """Return the features (B, hidden) in the dtype of x, to which the weights are cast."""
        x = self._pad_circular(x.transpose(1, 2))  # (B, L, C)
        x = first_stage(x, *weights(self.conv1))
        x = second_stage(self._pad_circular(x), *weights(self.conv2))
        dense = self.dense
        x = functional.linear(x.flatten(1), dense.weight.to(x.dtype), dense.bias.to(x.dtype))
        return functional.relu(x)

    def plain(self, x: Tensor) -> Tensor:
        """Return forward() from plain torch layers, the reference of the fast form."""
        for layer in (self.conv1, self.conv2):
            x = self._pad_circular(x.transpose(1, 2)).transpose(1, 2)
            x = plain_stage(x, *weights(layer))
        return functional.relu(self.dense(x.transpose(1, 2).flatten(1)))

    def _pad_circular(self, x: Tensor) -> Tensor:
        """Return x (B, L, C), with its first values repeated at its end if padding is circular."""
        return torch.cat([x, x[:, : KERNEL_SIZE - 1]], dim=1) if self.circular else x


class Actor(nn.Module):
    """
    From input (B, D, L) to mean and standard deviation of the action, (B, 2) m/s each.

    With two modes, drive and hold, the head has outputs for each, and a gate at its end: the
    logit of hold. An action is that of one mode, never a mean of the two.
    """

    def __init__(self, shape: tuple[int, int], config: NetworkConfig) -> None:
        """Create the network; its first mean is close to zero."""
        super().__init__()
        self.config = config
        self.body = Body(shape, config)
        self.width = 4 if config.std_type == 'state' else 2  # outputs of a mode
        gates = config.modes - 1
        self.head = nn.Linear(config.hidden, config.modes * self.width + gates)
        nn.init.orthogonal_(self.head.weight, 0.01)
        nn.init.zeros_(self.head.bias)
        if config.std_type == 'free':
            size = (2,) if config.modes == 1 else (config.modes, 2)
            self.log_std = nn.Parameter(torch.full(size, math.log(config.init_std)))

    def forward(self, x: Tensor, hold: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return action_of() the outputs for an input."""
        return self.action_of(self.outputs(x), hold)

    def outputs(self, x: Tensor) -> Tensor:
        """Return the outputs of the head for an input, (B, outputs) float32."""
        return self.head(self.body(x).float())

    def gate(self, out: Tensor) -> Tensor | None:
        """Return the logit of hold in outputs, (B,); None with one mode."""
        return out[:, -1] if self.config.modes == 2 else None

    def hold(self, out: Tensor) -> Tensor | None:
        """Return whether the gate chooses to hold, (B,) bool; None with one mode."""
        gate = self.gate(out)
        return None if gate is None else gate > 0

    def action_of(self, out: Tensor, hold: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """
        Return mean and standard deviation, (B, 2) m/s each, float32, of outputs of the head.

        hold (B,) bool is the mode; None: the one that the gate chooses.
        """
        hold = self.hold(out) if hold is None else hold
        own = out if hold is None else self._of_mode(out, hold)
        if self.config.std_type == 'state':
            log_std = own[:, 2:] + math.log(self.config.init_std)
        elif hold is None:
            log_std = self.log_std.expand(len(out), 2)
        else:
            log_std = torch.where(hold[:, None], self.log_std[1], self.log_std[0])
        low, high = math.log(self.config.min_std), math.log(self.config.max_std)
        return own[:, :2], log_std.clamp(low, high).exp()

    def _of_mode(self, out: Tensor, hold: Tensor) -> Tensor:
        """Return the outputs (B, width) of the mode."""
        drive, held = out[:, : self.width], out[:, self.width : 2 * self.width]
        return torch.where(hold[:, None], held, drive)


class Critic(nn.Module):
    """From input (B, D, L) to the expected return of the team, (B,)."""

    def __init__(self, shape: tuple[int, int], config: NetworkConfig) -> None:
        """Create the network for an input of shape (D, L)."""
        super().__init__()
        self.body = Body(shape, config)
        self.head = nn.Linear(config.hidden, 1)
        nn.init.orthogonal_(self.head.weight, 1.0)
        nn.init.zeros_(self.head.bias)

    def forward(self, x: Tensor) -> Tensor:
        """Return the value (B,) in float32."""
        return self.head(self.body(x).float())[:, 0]
