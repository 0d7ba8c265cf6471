"""
The commands of the package, as `shepherd_ros.entry_points:flock_sim`.

From the first line on, Ctrl-C ends a command that still imports at once and without a traceback.
"""

import signal

INTERRUPTED = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # not as with nohup
if INTERRUPTED:
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from collections.abc import Callable  # noqa: E402


def shepherd() -> int:
    """Run `shepherd`, which leaves what it has begun in order after Ctrl-C."""
    from shepherd_ros.cli import main

    try:
        if INTERRUPTED:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        return main()
    except KeyboardInterrupt:
        return 130


def __getattr__(name: str) -> Callable[[], int]:
    """Return the main function of a node."""
    from shepherd_ros.nodes import executables

    main: Callable[[], int] = getattr(executables, name)
    return main
