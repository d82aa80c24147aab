"""Checkpoints: one that is damaged, or is none of this fit, is one error."""

import os
from types import SimpleNamespace

import numpy as np
import pytest
import safetensors.torch
import torch
from helpers import ANALYTIC

from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import DirectConfig, FitTask, make_method
from mitsvbrdf.fit.checkpoint import differing, fingerprints, load_tensors, save_tensors
from mitsvbrdf.fit.loop import Loop

SIDE = 16
STATE = {"weights": torch.arange(6.0).reshape(2, 3), "count": torch.tensor(7), "none": torch.empty(0, 3),
         "half": torch.ones(3, dtype=torch.bfloat16), "flag": torch.tensor([True, False])}


def test_what_is_saved_is_loaded_here_and_by_the_library_of_the_format(tmp_path):
    note = {"iteration": 3, "lowest": float("inf"), "trace": [{"seconds": 0.1}]}
    save_tensors(tmp_path / "c", STATE, note)
    tensors, found = load_tensors(tmp_path / "c")
    assert found == note
    for loaded in (tensors, safetensors.torch.load_file(tmp_path / "c")):
        assert set(loaded) == set(STATE) and all(
            torch.equal(loaded[name], value) and loaded[name].dtype == value.dtype
            for name, value in STATE.items())


def test_every_bit_that_turns_over_is_seen_and_every_end_that_lacks(tmp_path):
    save_tensors(tmp_path / "whole", STATE, {"iteration": 3})
    whole = (tmp_path / "whole").read_bytes()
    damaged = [b"", b"not a checkpoint", whole[:100], whole[:-1]]
    for place in np.random.default_rng(0).choice(8 * len(whole), 400, replace=False):
        data = bytearray(whole)
        data[place // 8] ^= 1 << place % 8
        damaged.append(data)
    for data in damaged:
        (tmp_path / "c").write_bytes(data)
        with pytest.raises(ConfigError, match="a whole checkpoint"):
            load_tensors(tmp_path / "c")


def test_what_is_no_checkpoint_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")  # opening it would wait for ever
    safetensors.torch.save_file(STATE, tmp_path / "other")
    for name, said in (("pipe", "no such file"), ("", "no such file"), ("other", "by another program")):
        with pytest.raises(ConfigError, match=said):
            load_tensors(tmp_path / name)


def loop_of(capture):
    return Loop(make_method(FitTask(capture, ANALYTIC, DirectConfig(iterations=2),
                                    torch.full((SIDE, SIDE, 3), 0.2))))


def test_another_variant_is_another_fit(leather):
    told = [fingerprints(DirectConfig(), leather, SimpleNamespace(name="mitsuba", variant=variant), {})
            for variant in ("llvm_ad_rgb", "cuda_ad_rgb")]
    assert differing(*told) == ["--variant"]


def test_a_state_of_another_fit_is_one_error(leather, tmp_path):
    loop, path = loop_of(leather), tmp_path / "c"
    loop.checkpoint = path
    loop.run()
    tensors, note = load_tensors(path)
    wrong = [({}, {name: value}) for name in note.keys() - {"method", "bsdf", "task"}
             for value in (None, [1]) if (name, value) != ("lacked", [1])]  # which may be so
    for name in tensors:
        if not name.startswith("lowest."):  # looked at when a fit goes back
            wrong += [({name: other}, {}) for other in (torch.zeros(2, 2), None)]
    assert len(wrong) > 30
    for other_tensors, other_note in wrong:
        mixed = {name: value for name, value in (tensors | other_tensors).items() if value is not None}
        save_tensors(path, mixed, note | other_note)
        with pytest.raises(ConfigError, match="same options"):
            loop.resume(path)
    save_tensors(path, tensors, note)
    resumed = loop_of(leather)
    resumed.resume(path)
    assert resumed.iteration == 2
