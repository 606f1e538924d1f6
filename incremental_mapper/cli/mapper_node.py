"""``mapper_node``: the program of the ROS 2 node, which says so where there is no ROS."""

import signal
import sys
from collections.abc import Sequence

from incremental_mapper.cli import exit_status
from incremental_mapper.ros.arguments import read_own_arguments
from incremental_mapper.ros.programs import INSTALL


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM.

    Args:
        arguments: The program and its arguments; None takes those of this process.

    Returns:
        The exit status.
    """
    words = sys.argv if arguments is None else list(arguments)
    read_own_arguments(words[1:])
    # The node handles signals itself. To load it takes a second, and there is nothing to save yet.
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        from incremental_mapper.ros import node
    except ImportError as error:
        if (error.name or '').split('.')[0] == 'incremental_mapper':
            raise
        print(
            'mapper_node: needs rclpy and messages, which cannot be imported '
            f'({error.__cause__ or error}); {INSTALL}',
            file=sys.stderr,
        )
        return exit_status.FAILURE
    finally:
        signal.signal(signal.SIGINT, before)
    return node.main(words)


if __name__ == '__main__':
    sys.exit(main())
