"""Mutated files for every reader: each is read, or refused by one kind of error, in little time.

A target takes ``BSK_TORCH_FUZZ_SECONDS`` of CPU time, 0.3 s unless a longer search is asked for.
"""

import os
import time
from contextlib import suppress
from typing import Any

import pytest
import torch
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from tests.support.readers import readers

BUDGET = float(os.environ.get("BSK_TORCH_FUZZ_SECONDS", "0.3"))

LONGEST = 5.0
"""CPU time of a small file, s."""


FEWEST = 3
"""Files that are read in any case, also where the first one takes all the time."""


class SpentError(KeyboardInterrupt):
    """The time is over; Hypothesis passes interrupts on."""


ODD = [
    *(None, True, -1, 0, 1, 2**31, 2**63, 10**400, 0.5, -0.5, 1e300, float("nan"), float("inf")),
    *(
        "",
        "x",
        "a" * 500,
        "../../etc/passwd",
        "/etc/passwd",
        "\x1b]0;x\x07",
        "\ud800",
        "1",
        "torch.float64",
        "<class 'torch.Tensor'>",
    ),
    *([], {}, [[]], [0] * 2000, {"": {}}, {"type": "TensorDict"}),
]
"""Values in the place of others."""

TENSORS = [torch.zeros(0), torch.full((2,), torch.nan), torch.zeros(1).expand(10**9), torch.zeros(2, dtype=torch.bool)]


def places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths to some parts of a value."""
    parts = value.items() if isinstance(value, dict) else enumerate(value[:3]) if isinstance(value, list | tuple) else ()
    return [at, *(place for key, part in parts for place in places(part, (*at, key)))]


def changed(value: Any, at: tuple[Any, ...], how: str, new: Any) -> Any:
    """A value with a part that is replaced, missing, renamed, or nested."""
    if not at:
        return [value] if how == "nest" else new
    keys = dict(value) if isinstance(value, dict) else dict(enumerate(value))
    if len(at) > 1 or how in ("set", "nest"):
        keys[at[0]] = changed(keys[at[0]], at[1:], how, new)
    elif how == "delete":
        del keys[at[0]]
    else:
        keys[str(new)] = keys.pop(at[0])
    return keys if isinstance(value, dict) else type(value)(keys.values())


def damaged(data: st.DataObject, content: bytes) -> bytes:
    """Bytes of which some are flipped, cut off, repeated, or replaced."""
    place = data.draw(st.integers(0, len(content)))
    match data.draw(st.sampled_from(["cut", "flip", "insert", "repeat", "noise"])):
        case "cut":
            return content[:place]
        case "flip":
            return (
                content[:place]
                + bytes(b ^ (1 << data.draw(st.integers(0, 7))) for b in content[place : place + 1])
                + content[place + 1 :]
            )
        case "insert":
            return content[:place] + data.draw(st.binary(max_size=20)) + content[place:]
        case "repeat":
            return content[:place] + content[max(place - 50, 0) :]
    return data.draw(st.binary(max_size=200))


@pytest.mark.parametrize("name", readers())
def test_files_are_read_or_refused(name, tmp_path, record_property):
    reader, count = readers()[name], 0
    reader.of(tmp_path, reader.content)  # also imports what reading needs
    end = time.process_time() + BUDGET

    @settings(
        max_examples=10**6,  # until the time is spent
        derandomize=BUDGET < 1.0,  # the same files for the same code in CI, others at night
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(st.data())
    def run(data: st.DataObject) -> None:
        nonlocal count
        if count >= FEWEST and time.process_time() > end:
            raise SpentError
        content = reader.content
        if reader.changed is not None and data.draw(st.integers(0, 3)):

            def change(value: Any) -> Any:
                for _ in range(data.draw(st.integers(1, 2))):
                    at = data.draw(st.sampled_from(places(value)))
                    new = data.draw(st.sampled_from(ODD + (TENSORS if name in ("policy", "checkpoint", "trajectory") else [])))
                    value = changed(value, at, data.draw(st.sampled_from(["set", "set", "set", "delete", "rename", "nest"])), new)
                return value

            content = reader.changed(content, change)
        else:
            content = damaged(data, content)
        count += 1
        begin = time.process_time()
        refusal = ""
        try:
            reader.of(tmp_path, content)
        except (ValueError, OSError) as error:
            refusal = str(error) or "nothing\n"
        assert refusal.isprintable()  # one line, nothing that moves a cursor
        assert time.process_time() - begin < LONGEST

    with suppress(SpentError):
        run()
    assert count >= FEWEST
    record_property("files", count)
