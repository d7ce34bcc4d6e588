"""Data and a small trained model that several tests need."""

import pytest

import cape


@pytest.fixture(scope="session")
def packed(tmp_path_factory):
    place = tmp_path_factory.mktemp("data")
    made = cape.data.synth(place / "raw", subjects=1, frames_per_sequence=6)
    assert made["subjects"] == 1 and made["frames"] > 0
    report = cape.data.pack(place / "raw", place / "packed")
    assert report["broken"] == []
    return place / "packed"


@pytest.fixture(scope="session")
def run(packed):
    training = cape.train(data=packed, out=packed.parent / "run", preset="tiny", epochs=1, batch=64)
    assert training.finished
    return training.out
