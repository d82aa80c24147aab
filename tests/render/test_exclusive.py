"""Mitsuba's renderers in many threads: bits of one thread; the lock, Ctrl-C, the program's variant."""

import contextlib
import gc
import os
import random
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest
import torch
from helpers import GRID

from mitsvbrdf.capture.lens import Lens, Pose
from mitsvbrdf.fit.hierarchical import solver as solver_module
from mitsvbrdf.fit.hierarchical.solver import Observations, TexelSolver
from mitsvbrdf.io.signals import PROCESS
from mitsvbrdf.render import exclusive, make_renderer
from mitsvbrdf.render.exclusive import using_mitsuba
from mitsvbrdf.synth.traced import HandheldRenderer
from mitsvbrdf.testing import random_material

NAMES = ("mitsuba", "mitsuba-scene")
THREADS, MATERIALS = 8, 2


def picture(renderer, seed):
    """A picture and the gradients of its maps, with other work of other threads between the two."""
    leaves = random_material("roughconductor", 8, seed).map(lambda value: value.clone().requires_grad_())
    image = renderer.render(leaves, GRID.pick([seed, 5, 8]))
    threading.Event().wait(random.random() * 2e-3)
    return [image.detach(), *torch.autograd.grad(image.square().sum(), list(leaves.maps.values()))]


def in_threads(work, count):
    """What ``work(k)`` returns for k < count, in eight threads that start together."""
    together = threading.Barrier(THREADS)

    def begun(k):
        if k < THREADS:
            together.wait()
        return work(k)

    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(begun, range(count)))


@contextlib.contextmanager
def another_thread_draws():
    held, done = threading.Event(), threading.Event()

    def draw():
        with using_mitsuba():
            held.set()
            assert done.wait(30)

    with ThreadPoolExecutor(2) as pool:
        other = pool.submit(draw)
        assert held.wait(10)
        yield pool, done
        done.set()
        other.result()


def assert_free():
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(PROCESS.acquire, timeout=5).result()
        pool.submit(PROCESS.release).result()


def assert_threads_draw_what_one_draws(count):
    shared = {name: make_renderer(name) for name in NAMES}
    expected = {(name, seed): picture(shared[name], seed) for name in NAMES for seed in range(MATERIALS)}

    def drawn(k):
        name, seed = NAMES[k % 2], k // 2 % MATERIALS
        renderer = make_renderer(name) if k in (0, 1, 3) else shared[name]  # a scene of its own, too
        return (name, seed), picture(renderer, seed)

    for case, found in in_threads(drawn, count):
        assert all(map(torch.equal, found, expected[case])), case


def test_threads_draw_what_one_draws():
    assert_threads_draw_what_one_draws(4 * THREADS)


@pytest.mark.slow
def test_a_thousand_pictures_of_threads_are_those_of_one():
    assert_threads_draw_what_one_draws(1000)


@pytest.mark.slow
def test_first_import_from_many_threads():
    code = """if True:
        import threading
        import mitsvbrdf as mv
        found, failed = [], []
        names = ["fit_svbrdf", "make_renderer", "load_maps", "evaluate_fit", "write_fit", "make_material",
                 "guess_diffuse", "export_material"]
        together = threading.Barrier(len(names))
        def begin(name):
            together.wait()
            try:
                getattr(mv, name)
                view, made = mv.Views.of([[0, 0, 2.0]]), mv.make_material("inlay", 16)
                found.append(mv.make_renderer("mitsuba").render(made, view).sum().item())
            except BaseException as error:
                failed.append(repr(error))
        threads = [threading.Thread(target=begin, args=(name,)) for name in names]
        for each in threads: each.start()
        for each in threads: each.join()
        assert not failed and len(set(found)) == 1 and len(found) == len(names), (failed, found)"""
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert child.returncode == 0, child.stderr


def test_a_scene_drawn_in_between_leaves_a_picture_of_another_its_gradient():
    # The backward pass of the one drawn first left only zeros to the other.
    renderers, seeds = [make_renderer("mitsuba-scene") for _ in range(2)], range(2)
    expected = [picture(renderers[0], seed)[1:] for seed in seeds]
    leaves = [random_material("roughconductor", 8, seed).map(lambda value: value.clone().requires_grad_())
              for seed in seeds]
    images = [renderer.render(each, GRID.pick([seed, 5, 8]))
              for renderer, each, seed in zip(renderers, leaves, seeds)]
    for image, each, gradients in zip(images, leaves, expected):
        assert all(map(torch.equal, torch.autograd.grad(image.square().sum(), list(each.maps.values())),
                       gradients))


@pytest.mark.parametrize("name", NAMES)
def test_a_forward_pass_in_one_thread_goes_backward_in_another(name):
    renderer = make_renderer(name)
    leaves = random_material("principled", 8).map(lambda value: value.clone().requires_grad_())
    with ThreadPoolExecutor(1) as pool:
        image = pool.submit(renderer.render, leaves, GRID).result()
    found = torch.autograd.grad(image.sum(), list(leaves.maps.values()))
    expected = torch.autograd.grad(renderer.render(leaves, GRID).sum(), list(leaves.maps.values()))
    assert all(map(torch.equal, found, expected))


def arrays():
    import drjit as dr

    return len(dr.whos(as_string=True).splitlines())


def drawn(name):
    """A renderer, a picture whose gradient is still to come, and another picture with its gradients."""
    renderer, seed = make_renderer(name), 0
    leaves = random_material("roughconductor", 8, seed).map(lambda value: value.clone().requires_grad_())
    return renderer, renderer.render(leaves, GRID.pick([5, 8])), picture(renderer, seed)


def solved():
    """A solver of texels, and what it found."""
    material = random_material("roughconductor", 8)
    solver = TexelSolver("roughconductor")
    x = solver.numbers(material)
    photos = Observations(torch.full((2, 8, 8, 3), 0.5), GRID.pick([5, 8]), "srgb", 0.1)
    bounds = torch.full((len(x),), -9.0), torch.full((len(x),), 9.0)
    found = solver.solve(photos, x, torch.full((8, 8), 0.01), x, torch.ones_like(x), *bounds, iterations=1)
    return solver, found, solver.normal_equations(photos, x), solver.posterior(photos, x, torch.ones_like(x))


def photographed():
    """A simulated phone's renderer, and a photo of it."""
    renderer = HandheldRenderer(random_material("roughconductor", 8), 10.0, samples=1)
    lens = Lens((12, 8), 10.0)
    return renderer, renderer.render(lens, Pose.looking_at((1.0, 0.0, 20.0), (0.0, 0.0, 0.0)), 1.0)


@pytest.mark.parametrize("make", [partial(drawn, "mitsuba"), partial(drawn, "mitsuba-scene"), solved,
                                  photographed], ids=[*NAMES, "solver", "phone"])
def test_what_a_thread_forgets_is_freed_by_one_that_holds_the_lock(make):
    # Dr.Jit frees nothing beside another thread: in 3 of 100 processes of eight threads it crashed or waited
    # for ever.
    with using_mitsuba():
        gc.collect()
    at_first, made = arrays(), make()
    with using_mitsuba():
        pass
    at_most = arrays()
    with another_thread_draws():
        del made
        gc.collect()
        left = arrays()
    with using_mitsuba():
        pass
    assert left == at_most > at_first >= arrays()


def test_what_an_error_keeps_is_freed_before_the_lock_is(monkeypatch):
    def fails(values):
        import drjit as dr

        mine = dr.opaque(dr.llvm.Float, 1.0)
        raise KeyboardInterrupt(str(mine))

    solver, x = solved()[0], torch.zeros(9, 8, 8)
    photos = Observations(torch.full((2, 8, 8, 3), 0.5), GRID.pick([5, 8]), "srgb", 0.1)
    before = arrays()
    monkeypatch.setattr(solver_module, "to_torch", fails)
    with pytest.raises(KeyboardInterrupt) as error:
        solver.normal_equations(photos, x)
    left = arrays()
    assert error.traceback and left == before


@pytest.mark.slow
@pytest.mark.parametrize("keeps", ["", "global renderer, image; "])
def test_a_process_ends_well_with_a_picture_whose_gradient_was_never_taken(keeps):
    code = f"""if True:
        import mitsvbrdf as mv
        def draw():
            {keeps}
            maps = mv.make_material("inlay", 16).map(lambda value: value.clone().requires_grad_())
            renderer = mv.make_renderer("mitsuba-scene")
            image = renderer.render(maps, mv.Views.of([[0, 0, 2.0], [0.3, 0.2, 2.0]]))
            print(float(image.detach().mean()))
        draw()"""
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert child.returncode == 0 and not child.stderr, child.stderr


@pytest.mark.parametrize("name", NAMES)
def test_the_variant_of_a_program_is_left_as_it_was(name):
    with using_mitsuba() as mi:
        mi.set_variant("scalar_rgb")
        leaves = random_material("roughconductor", 8).map(lambda value: value.clone().requires_grad_())
        image = make_renderer(name).render(leaves, GRID.pick([0]))
        assert mi.variant() == "scalar_rgb"
        image.sum().backward()
        assert mi.variant() == "scalar_rgb" and leaves["diffuse"].grad.abs().sum() > 0
    assert mi.variant() == "llvm_ad_rgb"


def test_ctrl_c_while_another_thread_draws():
    # Whoever waits for the lock is interrupted, and does not keep it; after a render of Mitsuba, too, which
    # sets handlers.
    make_renderer("mitsuba-scene").render(random_material("roughconductor", 8), GRID.pick([0]))
    def press(done):  # until it is heard: one that comes just before the wait begins is heard after it
        while not done.wait(0.1):
            os.kill(os.getpid(), signal.SIGINT)

    with another_thread_draws() as (pool, done), pytest.raises(KeyboardInterrupt):
        pool.submit(press, done)
        with using_mitsuba():
            pass
    assert_free()


def test_ctrl_c_at_any_moment_frees_the_lock():
    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        for turn in range(200):
            with contextlib.suppress(KeyboardInterrupt):
                signal.setitimer(signal.ITIMER_REAL, 1e-4 + turn * 1e-6)
                while True:
                    with using_mitsuba():
                        pass
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert_free()


def test_a_map_changed_in_place_before_the_backward_pass_is_refused():
    for name in NAMES:
        roughness = torch.full((8, 8, 1), 0.5, requires_grad=True)
        changed = roughness * 1.0
        material = random_material("roughconductor", 8)
        image = make_renderer(name).render(type(material)(material.bsdf,
                                                          {**material.maps, "roughness": changed}), GRID)
        changed.detach().mul_(0.5)
        with pytest.raises(RuntimeError, match="modified by an inplace operation"):
            image.sum().backward()


def test_what_is_forgotten_after_pythons_end_is_no_error(monkeypatch):
    monkeypatch.setattr(exclusive, "_forgotten", None)  # as the end leaves it
    exclusive.Kept(1).__del__()
