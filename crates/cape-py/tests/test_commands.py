"""Commands as functions."""

import json
import urllib.request

import pytest

import cape


@pytest.fixture(scope="module")
def packed(tmp_path_factory):
    place = tmp_path_factory.mktemp("data")
    cape.data.synth(out=place / "raw", subjects=1, frames_per_sequence=6)
    cape.data.pack(place / "raw", out=place / "packed")
    return place / "packed"


def test_a_result_is_that_of_json(packed):
    frames = cape.data.inspect(packed)
    assert "train" in json.dumps(frames)
    body = cape.info("female")
    assert "6890" in json.dumps(body)


def test_metrics_of_a_training_are_passed_on(packed, tmp_path):
    metrics = []
    out = tmp_path / "run"
    cape.train(data=packed, out=out, preset="tiny", epochs=2, callback=metrics.append)
    written = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    assert metrics == written and metrics
    model = cape.Model.load(out)
    assert model.sample("longlong").vertices.shape == (1, 6890, 3)


def test_errors_are_those_of_the_program(tmp_path):
    with pytest.raises(cape.CapeError, match="nowhere"):
        cape.data.inspect(tmp_path / "nowhere")
    with pytest.raises(cape.CapeError, match="undress"):
        cape.data.undress()
    with pytest.raises(cape.CapeError, match="out"):
        cape.train(data="packed", callback=print)


def test_the_viewer_serves_its_page():
    with cape.Viewer("female") as viewer:
        page = urllib.request.urlopen(viewer.url, timeout=30).read()
        assert b"<html" in page.lower()
        assert viewer.url in viewer._repr_html_()
    with pytest.raises(cape.CapeError, match="nowhere"):
        cape.Viewer("nowhere")
