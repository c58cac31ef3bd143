"""The command line: `python -m tracer SCENE.xml [SCENE.xml ...]`; see `tracer.command.cli`."""

from typing import NoReturn

from tracer.command.process import run


def main() -> NoReturn:
    """Run the command ``tracer``, and end the process with its exit status."""
    run("tracer.command.cli")


if __name__ == "__main__":
    main()
