"""`python -m slam_gym COMMAND …`: the same as `slam-gym COMMAND …`."""

from __future__ import annotations

from slam_gym.commands import app

if __name__ == "__main__":
    app()
