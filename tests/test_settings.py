import dataclasses
import subprocess
import sys
from typing import Any

import pytest

import jaxblur
from jaxblur.filters import FILTERS, filter_info
from jaxblur.frame import check_frame
from tests.helpers import random_frame, with_slow


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"samples": 0}, "`samples` must be at least 1, got 0"),
        ({"radius": 0}, "`radius` must be at least 1, got 0"),
        ({"samples": 2.5}, "`samples` must be a whole number, got 2.5"),
        ({"radius": True}, "`radius` must be a whole number, got True"),
        ({"border": "wrap"}, "`border` must be one of 'skip', 'clamp', got 'wrap'"),
        ({"fetch": "cubic"}, "`fetch` must be one of"),
        ({"tile_choice": "all"}, "`tile_choice` must be one of"),
        ({"split": "odd"}, "`split` must be one of"),
        ({"noise": "blue"}, "`noise` must be one of"),
        ({"directions": "three"}, "`directions` must be one of"),
        ({"direction_weights": "half"}, "`direction_weights` must be one of"),
        ({"diagonal_tiles": "none"}, "`diagonal_tiles` must be one of"),
    ],
)
def test_settings_refuse(change, message):
    with pytest.raises(ValueError, match=message):
        jaxblur.GuertinSettings(**change)


def test_mcguire_refuses_an_even_number_of_samples():
    with pytest.raises(ValueError, match=r"must be odd for mcguire2012, got 14; use 15"):
        jaxblur.mcguire2012(
            random_frame((4, 4)),
            jaxblur.McGuireParameters(),
            settings=jaxblur.Settings(samples=14),
        )


@pytest.mark.parametrize("name", with_slow(FILTERS, "layered"))
def test_equal_settings_trace_once(name, monkeypatch):
    info = filter_info(name)
    parameters, settings = info.make_parameters(), info.settings
    frame = random_frame((5, 6))
    blur = info.call
    traces: list[int] = []

    def traced(*arguments: Any) -> Any:
        traces.append(1)
        return check_frame(*arguments)

    for module in (blur.__module__, "jaxblur.filters._arguments"):
        monkeypatch.setattr(sys.modules[module], "check_frame", traced, raising=False)
    blur(frame, parameters, settings=settings)
    assert traces
    count = len(traces)
    fields = {field: getattr(settings, field) for field in settings.__dataclass_fields__}
    blur(frame, parameters, settings=info.kind(**fields))
    assert len(traces) == count


def test_published_parameters_of_guertin():
    assert jaxblur.GuertinParameters() == jaxblur.GuertinParameters(
        kappa=40.0, gamma=1.5, tau=1.0, eta=0.95, phi=27.0, depth_sharpness=1.0
    )


def test_settings_are_static_before_any_filter_is_used():
    code = """
import jax, jaxblur
double = jax.jit(lambda x, settings: x * settings.samples)
for kind in (jaxblur.Settings, jaxblur.GuertinSettings, jaxblur.LayeredSettings):
    print(double(2, settings=kind(samples=9)))
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ran.stdout.split() == ["18"] * 3, ran.stderr


def test_a_setting_that_is_not_hashable_is_rejected_by_name():
    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Own(jaxblur.Settings):
        weights: Any = ()

    assert Own(weights=(1, 2)).weights == (1, 2)
    with pytest.raises(ValueError, match=r"`weights` must be hashable.*tuple.*got \[1, 2\]"):
        Own(weights=[1, 2])
