"""What each fork runs: the command line, but starting workers of Ray fails with an error of ours."""

import importlib
import pkgutil


def warm() -> None:
    """Import all that commands import."""
    import torch

    import mitsvbrdf

    for module in pkgutil.walk_packages(mitsvbrdf.__path__, "mitsvbrdf."):
        if module.name not in ("mitsvbrdf.__main__", "mitsvbrdf.testing.plugin"):
            importlib.import_module(module.name)
    importlib.import_module("OpenEXR")
    importlib.import_module("PIL.Image").init()
    # loads a compiler, which makes a folder for itself
    torch.optim.Adam([torch.zeros(1, requires_grad=True)]).step()
    _cut()


def main() -> int:
    from mitsvbrdf.__main__ import main as run

    return run()


def _cut() -> None:
    from mitsvbrdf.batch.tasks import RayTasks
    from mitsvbrdf.errors import BackendError

    def no_workers(*_: object, **__: object) -> None:
        raise BackendError("workers", "none, in a test", "run it without")

    RayTasks.__init__ = no_workers  # type: ignore[assignment,method-assign]
