"""Commands in this process, as they would be typed."""

from typer.testing import CliRunner, Result


def typed(app, *words) -> Result:
    """What a command says, and its exit code."""
    return CliRunner().invoke(app, [str(word) for word in words])
