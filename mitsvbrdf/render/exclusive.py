"""Mitsuba and Dr.Jit in one thread at a time, and the right gradients for each picture.

Neither is thread-safe: two threads that trace at once draw wrong pictures or end the process. So the import
of Mitsuba, each new scene, picture and backward pass take the lock :func:`using_mitsuba`. In between,
others may draw. Mitsuba's objects are freed under the lock too (:class:`Kept`). Returned tensors are copies.

The replay trap: the backward pass traces a Mitsuba scene *as it is at that time*, and Dr.Jit traces calls
through all existing scenes. If a camera moves or a preview is drawn between forward and backward, the
gradients are of the wrong picture, or 0. :class:`Drawing` prevents that: if any other picture was drawn
meanwhile, the backward pass first draws its own again, from the maps and views that it kept.
"""

from __future__ import annotations

import atexit
import contextlib
import signal
import sys
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from types import ModuleType
from typing import Any, Generic, TypeVar
from weakref import WeakSet

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..io.entry import entry, put_back
from ..io.signals import PROCESS
from ..kinds import kinds_checked
from ..material.maps import SVBRDF
from ..views import Views
from .bsdf import needed_maps
from .llvm import mitsuba_module, set_variant
from .needs import Needs, refuse_not_finite, scene_needs
from .plugins import register

T = TypeVar("T")

_forgotten = deque[object]()  # objects to be freed by the next thread that has the lock
_alive: WeakSet[Kept] = WeakSet()


class Kept(Generic[T]):
    """Keeps an object of Mitsuba or Dr.Jit. Any thread may drop it; a thread with the lock frees the object.

    Freeing an array while another thread traces can crash the process or cause a deadlock: the freeing thread
    waits, and has the GIL. So dropped content is freed by the next :func:`using_mitsuba`, or at the
    end of the process. The content must not refer to its :class:`Kept`.
    """

    def __init__(self, content: T) -> None:
        self.content = content
        _alive.add(self)

    def __del__(self) -> None:
        if _forgotten is not None:  # it is None at the end of Python, when everything was freed
            _forgotten.append(self.__dict__.pop("content", None))


@atexit.register
def _free_all() -> None:
    """Free everything while Dr.Jit is still loaded: freeing a scene's gradient later aborts the process."""
    for each in list(_alive):
        vars(each).clear()
    _forgotten.clear()


@kinds_checked
@contextlib.contextmanager
def using_mitsuba(variant: str = "llvm_ad_rgb") -> Iterator[ModuleType]:
    """The ``mitsuba`` module with this variant, for this thread alone; the earlier variant is restored.

    Calls of this package do not need it. Code that itself uses Mitsuba or Dr.Jit must run inside it. It may
    be nested. A backward pass of tensors on a GPU must not run inside it, because autograd runs the pass in
    another thread. Arrays and scenes should be freed before it ends: make them in a function.

    Raises:
        BackendError: Mitsuba, the variant, a GPU or libLLVM is missing.
    """
    with PROCESS:
        before = "mitsuba" in sys.modules and sys.modules["mitsuba"].variant() or variant
        mi = mitsuba_module(variant)
        _forgotten.clear()
        try:
            yield mi
        except BaseException as error:
            traceback.clear_frames(error.__traceback__)  # a kept error would keep the arrays of its frames
            raise
        finally:
            _forgotten.clear()
            signal.siginterrupt(signal.SIGINT, True)  # after Mitsuba's render a Ctrl-C wakes no thread
            if mi.variant() != before:
                put_back("the Mitsuba variant", partial(set_variant, mi, before))


@contextlib.contextmanager
def _in_order() -> Iterator[None]:
    """Inside, gradients of textures are identical in every run. By default each thread sums a part."""
    import drjit as dr

    before = dr.expand_threshold()
    dr.set_expand_threshold(0)
    try:
        yield
    finally:
        dr.set_expand_threshold(before)


class Drawing:
    """A function of torch tensors that Mitsuba computes, differentiable once, from any thread.

    ``function`` is made by ``dr.wrap``, and maps tensors to a list of pictures. With ``replayed``, the
    backward pass traces the function again, with the scene as it is at that time.
    """

    drawn = 0  # number of pictures of all scenes; if it rose meanwhile, scenes may have changed

    def __init__(self, variant: str, function: Callable[..., list[Tensor]], replayed: bool) -> None:
        self.variant, self.function, self.replayed = variant, Kept(function), replayed

    @contextlib.contextmanager
    def in_mitsuba(self) -> Iterator[None]:
        """The context of a forward or a backward pass."""
        with using_mitsuba(self.variant), _in_order() if self.replayed else contextlib.nullcontext():
            yield

    def __call__(self, *inputs: Tensor) -> Tensor:
        """The pictures stacked: N x R x R x 3."""
        wanted = [torch.is_grad_enabled() and tensor.requires_grad for tensor in inputs]
        return _Recorded.apply(self, wanted, *inputs) if any(wanted) else self.draw(inputs, wanted)[1]

    def draw(self, inputs: Sequence[Tensor], wanted: Sequence[bool]) -> tuple[list[Tensor], Tensor]:
        """The inputs as leaves of a new graph, and the pictures; the ``wanted`` leaves get gradients."""
        leaves = [tensor.detach().requires_grad_(want) for tensor, want in zip(inputs, wanted)]
        with self.in_mitsuba(), torch.set_grad_enabled(any(wanted)):
            Drawing.drawn += self.replayed
            parts = self.function.content(*leaves)
            return leaves, torch.cat([part.reshape(-1, *part.shape[-3:]) for part in parts])


class _Recorded(torch.autograd.Function):
    """Puts the pictures of a :class:`Drawing` into torch's graph."""

    @staticmethod
    def forward(ctx: Any, drawing: Drawing, wanted: list[bool], *inputs: Tensor) -> Tensor:
        ctx.save_for_backward(*inputs)
        with using_mitsuba(drawing.variant):
            record = drawing.draw(inputs, wanted)
            ctx.drawing, ctx.wanted, ctx.record, ctx.drawn = drawing, wanted, Kept(record), Drawing.drawn
        return record[1].detach()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:
        with ctx.drawing.in_mitsuba():
            gradients = iter(_gradients(ctx, ctx.saved_tensors, cotangent))  # raises if an input changed
        return None, None, *(next(gradients) if want else None for want in ctx.wanted)


def _gradients(ctx: Any, inputs: Sequence[Tensor], cotangent: Tensor) -> list[Tensor]:
    """Copies of the gradients of the inputs that need one; the recorded pictures are dropped."""
    record, ctx.record = ctx.record, None
    if record is None or ctx.drawing.replayed and ctx.drawn != Drawing.drawn:
        record = Kept(ctx.drawing.draw(inputs, ctx.wanted))
    leaves, images = record.content
    wanted = [leaf for leaf in leaves if leaf.requires_grad]
    with torch.enable_grad():  # of a sum: if given the cotangent, torch would import sympy (1 s)
        product = (images * cotangent).sum()
    return [each.clone() for each in torch.autograd.grad(product, wanted)]


class MitsubaRenderer:
    """The base of both Mitsuba renderers. ``needs``: what to compute; default: what each scene needs."""

    name: str
    replayed = False  # see Drawing

    def __init__(self, variant: str = "llvm_ad_rgb", needs: Needs | None = None) -> None:
        self.variant, self.needs = variant, needs
        with using_mitsuba(variant) as self.mi:
            register(variant)
        self.device = "cuda" if variant.startswith("cuda") else "cpu"
        self._drawings: dict[tuple, Drawing] = {}

    def __reduce__(self) -> tuple:
        return type(self), (self.variant, self.needs)

    @entry()
    def render(self, svbrdf: SVBRDF, views: Views) -> Tensor:
        """Linear radiance N x R x R x 3, float32; gradients to maps, camera, light and intensity."""
        refuse_not_finite(svbrdf, views)
        needs = self.needs or scene_needs(svbrdf, views, self.name)
        maps = needed_maps(svbrdf, needs)
        key = (svbrdf.bsdf, needs, svbrdf.resolution, views.falloff, tuple(maps))
        with using_mitsuba(self.variant):
            if key not in self._drawings:
                self._drawings[key] = Drawing(self.variant, self._wrap(*key), self.replayed)
        views = views.in_patch_sides()
        # dr.wrap takes plain tensors, and gives a gradient to each that needs one.
        tensors = [t.to(torch.float32).to(self.device).contiguous() for t in maps.values()]
        geometry = [t.to(torch.float64).to(self.device) for t in (views.camera, views.light, views.intensity)]
        at_once = self.views_at_once(svbrdf.resolution, torch.is_grad_enabled() and any(
            t.requires_grad for t in (*geometry, *tensors))) or len(views)
        images = [self._pictures(self._drawings[key], svbrdf.resolution,
                                 [part.contiguous() for part in parts], tensors)
                  for parts in zip(*(t.split(at_once) for t in geometry))]
        return (images[0] if len(images) == 1 else torch.cat(images)).to(svbrdf["normal"].device)

    def views_at_once(self, side: int, gradients: bool) -> int | None:
        """How many views one kernel draws; None: all."""
        return None

    def _pictures(self, drawing: Drawing, side: int, geometry: list[Tensor], maps: list[Tensor]) -> Tensor:
        """Pictures, N x R x R x 3, from cameras, lights, intensities and maps."""
        return drawing(*geometry, *maps)

    def _wrap(self, bsdf: str, needs: Needs, side: int, falloff: str,
              names: tuple[str, ...]) -> Callable[..., list[Tensor]]:
        """A function by ``dr.wrap``: cameras, lights, intensities (N x 3, float64), maps -> N pictures."""
        raise NotImplementedError
