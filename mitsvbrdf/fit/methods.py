"""The methods: name to settings. A new method is added here and in :func:`mitsvbrdf.fit.make_method`."""

from ..errors import ConfigError
from .config import DirectConfig, FitConfig, HierarchicalConfig, HybridConfig
from .gan_config import GanConfig

METHODS: dict[str, type[FitConfig]] = {  # the default first
    "hierarchical": HierarchicalConfig, "hybrid": HybridConfig, "gan": GanConfig, "direct": DirectConfig}


def method_name(config: FitConfig) -> str:
    """The name of the method that settings belong to; ConfigError: they belong to none."""
    for name, kind in METHODS.items():
        if isinstance(config, kind):
            return name
    raise ConfigError(f"a {', '.join(kind.__name__ for kind in METHODS.values())}",
                      type(config).__name__, "use one of these")
