"""Attacks on everything that reads files: `pytest tests/fuzz --fuzz 2000` tries so many inputs on each reader."""
