# What __getattr__ of __init__.py finds at run time, for type checkers and editors.
from .capture import Capture as Capture
from .capture import guess_diffuse as guess_diffuse
from .capture import read_capture as read_capture
from .capture import write_capture as write_capture
from .errors import MitsvbrdfError as MitsvbrdfError
from .evaluate import evaluate_capture as evaluate_capture
from .evaluate import evaluate_maps as evaluate_maps
from .evaluate.photos import evaluate_fit as evaluate_fit
from .export import ExportSettings as ExportSettings
from .export import export_material as export_material
from .export.mitsuba import write_scene as write_scene
from .fit import DirectConfig as DirectConfig
from .fit import Fit as Fit
from .fit import FitResult as FitResult
from .fit import GanConfig as GanConfig
from .fit import HierarchicalConfig as HierarchicalConfig
from .fit import HybridConfig as HybridConfig
from .fit import fit_svbrdf as fit_svbrdf
from .io.progress import Progress as Progress
from .material.made import make_material as make_material
from .material.map_files import load_maps as load_maps
from .material.map_files import save_maps as save_maps
from .material.maps import SVBRDF as SVBRDF
from .render import make_renderer as make_renderer
from .render.exclusive import using_mitsuba as using_mitsuba
from .report.folder import write_fit as write_fit
from .views import View as View
from .views import Views as Views

__version__: str
