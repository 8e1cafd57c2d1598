"""What fuzzing found stays found, and a short run of the same targets without coverage, the same every time."""

import random
from pathlib import Path

import pytest

from tests.fuzz.seeds import seeds
from tests.fuzz.targets import TARGETS

FINDINGS = sorted(path for path in (Path(__file__).parent / "findings").glob("*/*") if path.is_file())
SEEDS = seeds()
MUTANTS = {"3mf": 60, "glb": 150, "off": 150, "obj": 150, "ply": 150, "stl": 150}
MORE = 600
"""Of the targets that take microseconds."""
BOUNDARY = (b"\0", b"\xff", b"-1", b"1e999", b"nan", b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"{", b"[" * 64, b"\n", b" ")


@pytest.mark.parametrize("path", FINDINGS, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_finding_is_mended(path):
    TARGETS[path.parent.name](path.read_bytes())


@pytest.mark.parametrize("name", TARGETS)
def test_seeds_of_a_target_are_sound(name):
    for seed in SEEDS[name]:
        TARGETS[name](seed)


@pytest.mark.parametrize("name", TARGETS)
def test_mutants_of_sound_input_are_answered(name):
    chance = random.Random(name)
    for _ in range(MUTANTS.get(name, MORE)):
        TARGETS[name](mutant(chance.choice(SEEDS[name]), chance))


def mutant(data, chance):
    """Up to four changes: bits, boundary values, pieces cut out, doubled, or cut off."""
    changed = bytearray(data)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(changed) + 1)
        piece = chance.choice((1, 4, 16))
        kind = chance.randrange(5)
        if kind == 0 and at < len(changed):
            changed[at] ^= 1 << chance.randrange(8)
        elif kind == 1:
            changed[at : at + chance.choice((0, piece))] = chance.choice(BOUNDARY)
        elif kind == 2:
            del changed[at : at + piece]
        elif kind == 3:
            changed[at:at] = changed[at : at + piece]
        elif chance.random() < 0.2:
            del changed[at:]
    return bytes(changed)
