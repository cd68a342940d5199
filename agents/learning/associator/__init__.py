from agents.learning.associator.reproduction import reproduce

__all__ = ["reproduce"]
