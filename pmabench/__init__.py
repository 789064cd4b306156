"""pmabench: bench data acquisition and characterisation of pneumatic muscle actuators.

For notebooks, loaded when first used:

- `open_run(path)`: a run; `.trials`, `.trial(number)`, `.stream(name)`, `.events` are pandas tables
- `process(run, ...)`: its coefficients; `.to_frame()`, `.findings()`, `.dropped()`, `.trace(name)`, `.report(path)`
- `open_analysis(folder, ...)`: the same of what `pmabench process` wrote
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pmabench.notebook import Results, Run, open_analysis, open_run, process

__version__ = "0.1.0"
__all__ = ["Results", "Run", "__version__", "open_analysis", "open_run", "process"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from pmabench import notebook

        return getattr(notebook, name)
    raise AttributeError(f"module 'pmabench' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
