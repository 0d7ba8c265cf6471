"""Frames to a file: GIF with Pillow, MP4 with ffmpeg."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import itertools
from pathlib import Path
import shutil
import subprocess
import tempfile

import numpy as np
from PIL import Image
from shepherd_ros.config import ConfigError

Frames = Iterator[np.ndarray]  # (height, width, 3) uint8 each
Writer = Callable[[Frames, list[np.ndarray]], None]  # all frames; some, for the colours

COLORS = 128  # of a GIF, below 256: one more marks the pixels that stay as they are
LAST = 1.5  # [s] that a GIF rests on its last frame before it starts anew


def video_writer(path: Path, fps: float) -> Writer:
    """Return what writes frames to a .gif or .mp4, or raise ConfigError before any is drawn."""
    if not 1 <= fps <= 50:
        raise ConfigError(f'fps is {fps}: expected a value in [1, 50], such as 20')
    if not path.parent.is_dir():
        raise ConfigError(f'{path}: the folder {path.parent} is not there; make it first')
    kind = path.suffix.lower()
    if kind == '.gif':
        return lambda frames, samples: write_gif(path, frames, samples, fps)
    if kind != '.mp4':
        raise ConfigError(f'{path} ends in {kind!r}: expected .gif or .mp4')
    ffmpeg = shutil.which('ffmpeg')
    if ffmpeg is None:
        raise ConfigError(
            f'{path}: .mp4 needs ffmpeg, which is not on this machine; write a .gif, or install '
            'ffmpeg (sudo apt install ffmpeg)'
        )
    return lambda frames, samples: write_mp4(path, frames, fps, ffmpeg)


def write_gif(path: Path, frames: Frames, samples: list[np.ndarray], fps: float) -> None:
    """Write an endless GIF whose colours are chosen by the samples, the same in all frames."""
    palette, nearest = choose_colors(samples)

    def indexed(frame: np.ndarray) -> Image.Image:
        image = Image.fromarray(nearest[color_bin(frame)])
        image.putpalette(palette.tobytes())
        return image

    images = [indexed(frame) for frame in frames]
    durations = [round(1000 / fps)] * (len(images) - 1) + [round(1000 * LAST)]
    options = {'duration': durations, 'loop': 0, 'optimize': True}
    images[0].save(path, 'GIF', save_all=True, append_images=images[1:], **options)


def packed_rgb(colors: np.ndarray) -> np.ndarray:
    """Return colours (..., 3) as one number each, 0xRRGGBB."""
    return np.dot(colors.astype(np.uint32), np.array([1 << 16, 1 << 8, 1], np.uint32))


def color_bin(colors: np.ndarray) -> np.ndarray:
    """Return the bin of colours (..., 3) uint8 in a cube with 32 bins per edge, (...) int."""
    red, green, blue = (colors[..., i].astype(np.intp) >> 3 for i in range(3))
    return red << 10 | green << 5 | blue


def choose_colors(samples: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """
    Return at most COLORS colours, (K, 3) uint8, and the index of the nearest for each bin, uint8.

    The most frequent colour of a bin stands for it. Colours are added one by one, each time the
    one missed most: by its pixels times its squared distance to the nearest colour chosen before.
    """
    packed = np.concatenate([packed_rgb(sample).ravel() for sample in samples])
    packed, counts = np.unique(packed, return_counts=True)
    colors = np.stack([packed >> 16, packed >> 8 & 255, packed & 255], axis=-1)
    order = np.argsort(counts, kind='stable')
    bins = color_bin(colors)
    stands = np.arange(32**3)[:, None] >> (10, 5, 0) & 31
    stands = stands * 8 + 4  # a bin's middle, where no sample has a colour of it
    weight = np.zeros(32**3)
    stands[bins[order]] = colors[order]
    np.add.at(weight, bins, counts)
    gap, nearest = np.full(32**3, 1e9), np.zeros(32**3, 'u1')
    palette: list[np.ndarray] = []
    while len(palette) < COLORS and (cost := weight * gap).max() > 0:
        palette.append(stands[cost.argmax()])
        away = ((stands - palette[-1]) ** 2).sum(axis=1)
        nearest[away < gap] = len(palette) - 1
        gap = np.minimum(gap, away)
    return np.array(palette, 'u1'), nearest


def write_mp4(path: Path, frames: Frames, fps: float, ffmpeg: str) -> None:
    """Write a video that browsers play, through a pipe to ffmpeg; sizes have to be even."""
    first = next(frames)
    size = f'{first.shape[1]}x{first.shape[0]}'
    command = [ffmpeg, '-y', '-loglevel', 'error', '-f', 'rawvideo', '-pix_fmt', 'rgb24']
    command += ['-s', size, '-r', str(fps), '-i', '-', '-pix_fmt', 'yuv420p']
    command += ['-movflags', '+faststart', str(path.absolute())]
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=log)
        with contextlib.suppress(BrokenPipeError), process:  # if it gives up, the log says why
            assert process.stdin is not None  # as it is a pipe
            for frame in itertools.chain([first], frames):
                process.stdin.write(frame.tobytes())
        if process.returncode != 0:
            log.seek(0)
            raise RuntimeError(f'ffmpeg could not write {path}: {log.read().decode().strip()}')
