"""A command of the program, called within the test's own process."""

from click.testing import CliRunner

from pmabench.cli.main import main


def call(*args, code=0):
    """What a command printed and how it ended, which must be with exit code `code`; its exceptions are the test's."""
    result = CliRunner().invoke(main, [str(arg) for arg in args], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result
