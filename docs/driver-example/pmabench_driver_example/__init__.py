"""A pressure controller that takes lines of text over TCP, as an example of a driver in a package of its own."""

from pmabench_driver_example.driver import ExampleController

__all__ = ["ExampleController"]
