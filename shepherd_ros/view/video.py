"""Frames to a file: GIF with Pillow, MP4 with imageio and the ffmpeg that comes with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
import subprocess
from typing import Any

import imageio.v2 as imageio
import numpy as np
from PIL import Image
from shepherd_ros.config import ConfigError

_Frames = Iterator[np.ndarray]  # (height, width, 3) uint8 each
Writer = Callable[[_Frames, list[np.ndarray]], None]  # all frames; some, for the colours

GIF_COLORS = 128
LAST_FRAME_TIME = 1.5  # [s] that a GIF rests on its last frame before it starts anew


def video_writer(path: Path, fps: float) -> Writer:
    """Return the writer of frames to a .gif or .mp4; raise ConfigError before any is drawn."""
    if not 1 <= fps <= 50:
        raise ConfigError(f'fps is {fps}: expected a value in [1, 50], such as 20')
    if not path.parent.is_dir():
        raise ConfigError(f'{path}: the folder {path.parent} is not there; make it first')
    kind = path.suffix.lower()
    if kind == '.gif':
        return lambda frames, samples: write_gif(path, frames, samples, fps)
    if kind == '.mp4':
        return lambda frames, samples: write_mp4(path, frames, fps)
    raise ConfigError(f'{path} ends in {kind!r}: expected .gif or .mp4')


def write_gif(path: Path, frames: _Frames, samples: list[np.ndarray], fps: float) -> None:
    """Write an endless GIF whose colours are chosen by the samples, the same in all frames."""
    palette = Image.fromarray(np.concatenate(samples)).quantize(
        GIF_COLORS, method=Image.Quantize.MAXCOVERAGE
    )
    images = [
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in frames
    ]
    durations = [round(1000 / fps)] * (len(images) - 1) + [round(1000 * LAST_FRAME_TIME)]
    options = {'duration': durations, 'loop': 0, 'optimize': True}
    images[0].save(path, 'GIF', save_all=True, append_images=images[1:], **options)


def write_mp4(path: Path, frames: _Frames, fps: float) -> None:
    """Write a video that browsers play; frames have even sides."""
    writer: Any
    with imageio.get_writer(path, fps=fps, codec='libx264', macro_block_size=2) as writer:
        for frame in frames:
            writer.append_data(frame)


def ffmpeg_version() -> str:
    """Return version and path of the ffmpeg that is used, or raise; it is started for that."""
    from imageio.plugins.ffmpeg import get_exe

    path = get_exe()
    result = subprocess.run(
        [path, '-version'], capture_output=True, text=True, check=True, timeout=30
    )
    return f'{result.stdout.split()[2]} at {path}'
