"""Paths of files installed beside the code: schemas, checkpoints, executables."""

from __future__ import annotations

from importlib.metadata import distributions
from pathlib import Path
import shutil
import sys

PACKAGE = 'shepherd_ros'
INSTALLS = {  # what pip is told of modules with another name
    'PIL': 'pillow', 'foxglove': 'foxglove-sdk', 'rclpy': "'shepherd_ros[jazzy]'",
    'yaml': 'pyyaml',
}  # fmt: skip


def missing_package(error: ModuleNotFoundError) -> str:
    """Return what to install where an import fails; raises the error for modules of ours."""
    module = (error.name or PACKAGE).partition('.')[0]
    if module == PACKAGE:
        raise error
    return f'{module} is not installed: pip install {INSTALLS.get(module, module)}'


def is_installed(package: str) -> bool:
    """Return whether a package of ROS is in the ament index."""
    try:
        from ament_index_python.packages import get_package_prefix

        return bool(get_package_prefix(package))
    except (ImportError, LookupError, OSError):  # no ROS, no such package, no AMENT_PREFIX_PATH
        return False


def share_file(*parts: str) -> Path:
    """
    Return the path of a shared file: in the checkout, the ament index, or beside this Python.

    Raises FileNotFoundError that names every place looked at.
    """
    checkout = Path(__file__).resolve().parents[1]
    places = [checkout] if (checkout / 'package.xml').exists() else []
    try:
        from ament_index_python.packages import get_package_share_directory

        places.append(Path(get_package_share_directory(PACKAGE)))
    except (ImportError, LookupError, OSError):  # no ROS, no such package, no AMENT_PREFIX_PATH
        pass
    places.append(Path(sys.prefix) / 'share' / PACKAGE)
    for place in places:
        path = place.joinpath(*parts)
        if path.exists():
            return path
    looked = ', '.join(str(place) for place in places)
    raise FileNotFoundError(f'{Path(*parts)} is in none of {looked}: install the package again')


def quick_profile() -> tuple[str, Path]:
    """Return a variable and a file that let nodes find each other sooner, for this Fast DDS."""
    if is_installed('fastdds') or any(distributions(name='ros-fastdds')):  # version 3, Kilted
        return 'FASTDDS_DEFAULT_PROFILES_FILE', share_file('config', 'fastdds3_quick.xml')
    return 'FASTRTPS_DEFAULT_PROFILES_FILE', share_file('config', 'fastdds_quick.xml')


def executable_path(name: str) -> Path | None:
    """Return the path of an executable: beside this Python, or on the PATH; None if neither."""
    beside = Path(sys.executable).parent / name
    path = beside if beside.exists() else shutil.which(name)
    return Path(path) if path else None
