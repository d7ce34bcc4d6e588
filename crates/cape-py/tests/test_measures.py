"""Functions that measure, draw, export and judge."""

import json
import shutil
import urllib.request

import numpy as np
import pytest

import cape


def test_a_run_is_measured(run, packed, tmp_path):
    found = cape.eval.run(run, packed, batch=8, map=tmp_path / "errors.ply", posterior="mean")
    assert json.loads((run / "eval.json").read_text())
    assert "mean" in json.dumps(found)
    assert cape.Mesh.load(tmp_path / "errors.ply").vertices.shape == (6890, 3)
    quality = cape.eval.samples(cape.Model.load(run), frames=4, prior="normal")
    assert quality == json.loads((run / "samples.json").read_text())
    with pytest.raises(cape.CapeError, match="nowhere"):
        cape.eval.run(run, tmp_path / "nowhere")


def test_runs_are_compared(run, tmp_path):
    shutil.copytree(run, tmp_path / "other")
    table = cape.eval.compare(run, cape.Model.load(tmp_path / "other"), out=tmp_path / "table")
    assert table and (tmp_path / "table" / "compare.md").exists()
    with pytest.raises(cape.CapeError, match="built-in model has no directory"):
        cape.eval.compare(run, cape.Model.pretrained())


def test_the_effect_of_the_pose_is_measured(tmp_path):
    found = cape.eval.pose(None, tmp_path / "effect", pose_b="walk", outfit="longlong", seed=1)
    assert found == json.loads((tmp_path / "effect" / "pose_effect.json").read_text())
    assert (tmp_path / "effect" / "pose_effect.png").read_bytes().startswith(b"\x89PNG")


def test_speed_is_measured():
    assert cape.eval.speed(batch=1, preset="tiny")["preset"] == "tiny"


def test_table_2_is_estimated(packed, tmp_path):
    found = cape.table2(tmp_path / "table", data=packed, preset="tiny", rows=["cape"], epochs=1, dry_run=True)
    assert found and not (tmp_path / "table").exists()


def test_a_learning_rate_is_found(packed, tmp_path):
    rates = cape.find_rate(data=packed, out=tmp_path / "rates", trial_steps=12, preset="tiny", batch=4)
    assert rates["suggested"] > 0 and (tmp_path / "rates" / "rates.png").exists()
    with pytest.raises(cape.CapeError, match="batch"):
        cape.check(data=packed, preset="tiny", batch=0)


def test_samples_variations_and_motions_are_written(run, tmp_path):
    cape.sample(None, tmp_path / "samples", outfit="longlong", n=2, betas=np.array([1.0, -0.5]), format="ply")
    assert len(list((tmp_path / "samples").glob("*.ply"))) == 2
    cape.vary(run, tmp_path / "varied", by="between", codes=["seed:1", "mean"], columns=3, no_meshes=True)
    assert list((tmp_path / "varied").glob("*.png"))
    cape.animate(run, tmp_path / "moving", motion="squats", seconds=0.2, size=64, code="mean")
    assert list((tmp_path / "moving").glob("*.png"))
    cape.animate(None, tmp_path / "file", motion="squats", seconds=0.2, format="glb", every=2)
    assert list((tmp_path / "file").glob("*.glb"))
    report = cape.redress(
        run, "frame:0", tmp_path / "redressed", pose=["squats"], to=[[1.0, -2.0], "frame:1"], exact=True
    )
    assert len(report["transferred"]) == 2
    site = cape.export_view(run, tmp_path / "site")
    assert (tmp_path / "site" / "index.html").exists() and site["bytes"] > 1e5


def test_models_are_converted(run, packed, tmp_path):
    cape.model.export(None, onnx=tmp_path / "graphs", half=True)
    assert {path.name for path in (tmp_path / "graphs").glob("*.onnx")} >= {"decoder.onnx", "smpl.onnx"}
    cape.model.export(run, npz=tmp_path / "weights.npz")
    with np.load(tmp_path / "weights.npz") as weights:
        assert weights.files
    encoded = cape.model.encode(run, "frame:0", "frame:1", out=tmp_path / "codes")
    codes = np.load(tmp_path / "codes" / "codes.npy")
    assert len(encoded["encoded"]) == len(codes) == 2
    assert cape.model.prior(run, packed, kind="kde", frames=16, joint=True)
    assert (run / "prior-kde.npz").exists()
    cape.create(gender="female").model.save(tmp_path / "body.npz")
    cape.model.pyramid(tmp_path / "body.npz", tmp_path / "levels", factors=[2, 4])
    assert (tmp_path / "levels" / "level_2.obj").exists()
    with pytest.raises(cape.CapeError, match="nowhere"):
        cape.model.import_(tmp_path / "nowhere", tmp_path / "run", stats="stats.npz", body="body.npz")
    with pytest.raises(cape.CapeError, match="nowhere"):
        cape.body.make(tmp_path / "nowhere.whl", "female", tmp_path / "body.npz")


def test_a_run_becomes_one_file(run, tmp_path):
    path = tmp_path / "model.safetensors"
    cape.model.pack(run, path, note={"licence": "CC BY 4.0", "author": "somebody"})
    assert b"CC BY 4.0" in path.read_bytes()[:65536]
    model = cape.Model.load(path)
    code = model.codes("longlong", seed=3)
    np.testing.assert_allclose(
        model.decode(code, "longlong"), cape.Model.load(run).decode(code, "longlong"), atol=1e-3
    )


def test_a_study_is_made_served_and_scored(run, tmp_path):
    study = tmp_path / "study"
    cape.study.make(run, study, poses=2, a_pose=1, matched=1, catches=1, practice=1, trials=4, seed=1)
    with cape.study.serve(study, raters=2) as served:
        assert len(served.links) == 2
        for url in served.links.values():
            assert b"<html" in urllib.request.urlopen(url, timeout=30).read().lower()
    cape.study.export(study, tmp_path / "site", raters=3, completion="https://example.org/done")
    assert (tmp_path / "site" / "index.html").exists()
    planned = cape.study.score(study, plan=5, expect=0.4, deviations=(0.5, 0.25))
    assert planned
    with pytest.raises(cape.CapeError, match="nowhere"):
        cape.study.score(study, answers=[tmp_path / "nowhere.json", tmp_path / "other.json"])
    with pytest.raises(cape.CapeError, match="nowhere"):
        cape.study.serve(tmp_path / "nowhere")


def test_fits_to_scans_are_measured(run, packed, tmp_path):
    found = cape.fit.benchmark_scan(
        run, tmp_path / "scans", data=packed, frames=1, points=500, noise=[2], holes=[0.0]
    )
    assert found == json.loads((tmp_path / "scans" / "benchmark.json").read_text())
