"""The command `photocurrent`."""

import signal
import sys

from photocurrent import _native


def main() -> int:
    """Runs the command with the arguments of this process, and gives its exit code."""
    # Ctrl-C is the command's: it stops a run at its next step.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _native.main(["photocurrent", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
