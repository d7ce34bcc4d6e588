"""Commands as functions."""

import _thread
import functools
import http.server
import json
import os
import subprocess
import sys
import threading
import time
import urllib.request

import numpy as np
import pytest

import cape
from browser import pixels, screenshot
from cape import _program


def test_values_become_words():
    given = {"a": 1, "b_c": True, "d": False, "e": None, "f_g": [1, -2.5], "h_": {"x": 1, "y": 2}}
    assert _program.option_words(given) == ["-a=1", "--b-c", "--f-g=1,-2.5", "--h=x=1,y=2"]
    several = {"to": _program.Repeated(["a", [1, -2]]), "of": _program.Words([0.5, 1])}
    assert _program.option_words(several) == ["--to=a", "--to=1,-2", "--of", "0.5", "1"]
    assert _program.text(np.float32(0.5)) == "0.5" and _program.text(np.int64(3)) == "3"
    assert _program.text(np.array([1.0, -2.5])) == "1.0,-2.5"


def test_results_are_those_of_json(packed):
    found = cape.data.inspect(packed)
    assert "train" in json.dumps(found)
    assert "6890" in json.dumps(cape.info("female"))
    again = subprocess.run(
        [sys.executable, "-m", "cape", "data", "inspect", packed, "--json"], capture_output=True, check=True
    )
    assert json.loads(again.stdout) == found


def lines(out):
    return [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]


def test_metrics_of_a_training_are_passed_on(packed, tmp_path):
    metrics = []
    out = tmp_path / "run"
    training = cape.train(callback=metrics.append, data=packed, out=out, preset="tiny", epochs=2)
    assert metrics == lines(out) and metrics
    assert training.finished and training.epochs == 2 and training.best_validation > 0
    assert training.model().sample("longlong").vertices.shape == (1, 6890, 3)


def test_a_configuration_is_a_file_or_a_mapping(packed, run, tmp_path):
    tables = {"train": {"epochs": 3, "batch": 32, "schedule": "cosine", "preload": True}}
    with pytest.raises(cape.CapeError, match="epochs"):
        cape.train({"train": {"epochs": -1}}, data=packed, out=tmp_path / "wrong")
    with pytest.raises(cape.CapeError, match="train.*`fast`|fast"):
        cape.train({"train": {"fast": 1}}, data=packed, out=tmp_path / "wrong")
    with pytest.raises(cape.CapeError, match="`epochs`"):
        cape.train({"train": {"epochs": object()}}, data=packed, out=tmp_path / "wrong")
    path = tmp_path / "config.toml"
    text = (run / "config.toml").read_text()
    path.write_text(text)
    first = cape.train(path, data=packed, out=tmp_path / "file", epochs=1)
    assert first.finished
    tomllib = pytest.importorskip("tomllib")
    from cape.training import toml

    assert tomllib.loads(toml(tables)) == tables
    whole = tomllib.loads(text)
    assert tomllib.loads(toml(whole)) == whole
    second = cape.train(whole, data=packed, out=tmp_path / "mapping", epochs=1)
    assert lines(second.out)[-1]["step"] == lines(first.out)[-1]["step"]
    written = tomllib.loads((second.out / "config.toml").read_text())
    assert written == tomllib.loads((first.out / "config.toml").read_text())


def test_an_exception_of_the_callback_stops_a_training_that_then_goes_on(packed, tmp_path):
    out = tmp_path / "run"

    class Enough(Exception):
        pass

    def stop(metrics):
        raise Enough(metrics["step"])

    tables = {"epochs": 200, "batch": 8, "log_steps": 1}
    whole = pytest.importorskip("tomllib").loads((packed.parent / "run" / "config.toml").read_text())
    whole["train"].update(tables)
    with pytest.raises(Enough):
        cape.train(whole, stop, data=packed, out=out)
    before = lines(out)
    assert 0 < before[-1]["epoch"] < 200
    seen = []

    def stop_later(metrics):
        seen.append(metrics["step"])
        if len(seen) > 3:
            raise Enough

    with pytest.raises(Enough):
        cape.train(callback=stop_later, out=out, resume=True)
    assert seen[0] > before[-1]["step"] - 1
    assert cape.Model.load(out).sample("longlong").vertices.shape == (1, 6890, 3)


def test_an_interrupt_stops_a_training(packed, run, tmp_path):
    out = tmp_path / "run"
    whole = pytest.importorskip("tomllib").loads((run / "config.toml").read_text())
    whole["train"].update({"epochs": 200, "batch": 8, "log_steps": 1})

    def interrupt():
        end = time.monotonic() + 60
        while not (out / "metrics.jsonl").exists() and time.monotonic() < end:
            time.sleep(0.05)
        _thread.interrupt_main()

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        cape.train(whole, lambda metrics: None, data=packed, out=out)
    thread.join()
    assert list((out / "checkpoints").iterdir())
    assert cape.info(out)


def test_errors_are_those_of_the_program(tmp_path):
    with pytest.raises(cape.CapeError, match="nowhere"):
        cape.data.inspect(tmp_path / "nowhere")
    with pytest.raises(cape.CapeError, match="minutes"):
        cape.demo(tmp_path / "demo", minutes=-1)
    with pytest.raises(TypeError, match="subject"):
        cape.data.synth(tmp_path / "raw", subject=1)


def test_bodies_are_generated(run, tmp_path):
    model = cape.Model.load(run)
    report = cape.data.generate(model, tmp_path / "bodies", n=3, outfit=["longlong"], seed=2)
    assert report["bodies"] == 3
    (path,) = (tmp_path / "bodies").glob("*.npz")
    assert np.load(path)["vertices"].shape == (3, 6890, 3)


@pytest.fixture(scope="module")
def observed(packed, run):
    """Keypoints and mask of a held-out frame of the benchmark."""
    place = packed.parent
    (place / "few.toml").write_text(FEW)
    cape.fit.benchmark_image(
        run, out=place / "seen", frames=1, size=128, config=place / "few.toml", data=packed
    )
    return place / "seen" / "best"


#: Few steps: these tests are of the functions, not of the method.
FEW = """
[smplify]
accepted = 1e9
facing = [0.0]
stages = [{ pose = 20.0, shape = 10.0 }, {}]

[smplify.optimiser]
steps = 20

[clothed]
levels = [{ side = 64, rounds = 1, steps = 3 }]
inside = 0.0
explained = 0.0
"""


def test_a_body_is_fitted_to_an_image(observed, run, tmp_path):
    config = run.parent / "few.toml"
    files = cape.fit.image(
        run, observed / "keypoints.json", observed / "mask.png", tmp_path / "fit", config=config
    )
    assert files.vertices.shape == files.bare.shape == (6890, 3)
    assert files.pose.shape == (72,) and files.problem is None
    assert json.loads((tmp_path / "fit" / "fit.json").read_text()) == files.report
    np.testing.assert_array_equal(np.load(tmp_path / "fit" / "code.npy"), files.code)
    clothed = cape.Model.load(run).clothing
    far = np.linalg.norm(files.vertices - files.bare, axis=1)
    assert far[clothed].max() > 1e-3 and np.delete(far, clothed).max() < 1e-4
    # The same from arrays, without files.
    model = cape.Model.load(run)
    person = json.loads((observed / "keypoints.json").read_text())["people"][0]
    keypoints = np.array(person["pose_keypoints_2d"]).reshape(-1, 3)
    mask = pixels((observed / "mask.png").read_bytes()).max(axis=-1)
    arrays = cape.fit.image(model, keypoints, mask, config=config)
    assert arrays.outfit == files.outfit
    np.testing.assert_allclose(arrays.vertices, files.vertices, atol=1e-4)
    assert files.picture.startswith(b"\x89PNG") and "srcdoc" in arrays._repr_html_()
    assert files.mesh().colours is not None


def test_an_unreliable_fit_warns(observed, run, tmp_path):
    config = tmp_path / "strict.toml"
    config.write_text(FEW.replace("inside = 0.0", "inside = 1.0"))
    with pytest.warns(RuntimeWarning, match="unreliable"):
        fit = cape.fit.image(run, observed / "keypoints.json", observed / "mask.png", config=config)
    assert "unreliable" in fit.problem


def test_wrong_observations_are_refused(observed, run):
    with pytest.raises(cape.CapeError, match=r"keypoints: shape \[3\], expected \[k, 3\]"):
        cape.fit.image(run, [1, 2, 3])
    with pytest.raises(cape.CapeError, match=r"mask: shape \[3, 3, 3\]"):
        cape.fit.image(run, observed / "keypoints.json", np.zeros((3, 3, 3)))
    with pytest.raises(cape.CapeError, match=r"shape \[4, 2\], expected \[n, 3\]"):
        cape.fit.scan(run, np.zeros((4, 2)))
    with pytest.raises(cape.CapeError, match="nowhere"):
        cape.fit.scan(run, "nowhere.ply")


def test_a_body_is_fitted_to_a_scan(run, tmp_path):
    model = cape.Model.load(run)
    truth = model.sample("longlong", pose="a-pose", seed=4)
    mesh = truth.mesh()
    points = mesh.vertices[mesh.faces].mean(axis=1)[::8]
    for scan in (points, mesh):
        fit = cape.fit.scan(model, scan, outfit="longlong", pose="a-pose", seed=1)
        assert fit.problem is None and fit.outfit == "longlong"
        error = np.linalg.norm(fit.vertices - mesh.vertices, axis=1).mean()
        assert error < 0.02
    kept = cape.fit.scan(
        model, mesh.to_trimesh() if has("trimesh") else mesh, tmp_path / "fit",
        outfit="longlong", pose="a-pose", free_displacement=True, smooth=2, frame=3, seed=1,
    )
    assert "000003" in kept.report["free"]["registration"]
    np.testing.assert_array_equal(np.load(tmp_path / "fit" / "pose.npy"), kept.pose)


def has(name):
    try:
        __import__(name)
    except ImportError:
        return False
    return True


def test_a_pose_prior_is_fitted(packed, tmp_path):
    report = cape.fit.pose_prior(packed, out=tmp_path / "prior.npz", components=2)
    assert report["components"] == 2 and (tmp_path / "prior.npz").exists()


def test_a_layer_is_simulated_learned_and_predicted(tmp_path):
    simulated = cape.layer.synth(
        tmp_path / "skirt", frames=4, resolution=50, steps=10, exercises=["march"], subjects=[-1, 0]
    )
    assert simulated
    cape.layer.synth(
        tmp_path / "sizes", frames=4, resolution=50, steps=10, exercises=["march"], lengths=[1, 1.2]
    )
    cape.layer.learn(tmp_path / "sizes", tmp_path / "fits", components=2)
    fits = tmp_path / "fits" / "layer.npz"
    draws = cape.layer.predict_random(fits, 3, tmp_path / "draws", motion="squats", seconds=0.1)
    assert len(draws) == 3 and len({draw.parameters["length"] for draw in draws}) == 3
    assert (tmp_path / "draws" / "random.json").exists()
    assert draws[0].vertices.shape == draws[1].vertices.shape
    assert (draws[0].vertices != draws[1].vertices).any()
    associated = cape.layer.associate(tmp_path / "skirt", tmp_path / "associated", compare=[1, 4])
    assert associated["clothing_vertices"] > 50
    learned = cape.layer.learn(tmp_path / "skirt", tmp_path / "learned", components=2)
    assert learned["out"] == str(tmp_path / "learned")
    layer = tmp_path / "learned" / "layer.npz"
    moving = cape.layer.predict(layer, seconds=0.2, motion="squats", betas=[1, -1])
    assert len(moving) == len(moving.vertices) > 3 and np.isfinite(moving.vertices).all()
    assert moving.vertices.shape[1] == associated["clothing_vertices"]
    assert moving.mesh(1).faces.max() < moving.vertices.shape[1]
    assert moving.picture.startswith(b"\x89PNG") and "srcdoc" in moving._repr_html_()
    kept = cape.layer.predict(layer, tmp_path / "kept", seconds=0.2, motion="squats", betas=[1, -1])
    assert len(list((tmp_path / "kept").glob("frame-*.ply"))) == len(kept)
    np.testing.assert_array_equal(kept.vertices, moving.vertices)
    with pytest.raises(cape.CapeError, match="colour"):
        cape.layer.predict(layer, parameters={"colour": 2.0})
    with pytest.raises(cape.CapeError, match="no other parameters"):
        cape.layer.predict_random(layer, 2, seconds=0.1)
    worn = cape.layer.transfer(tmp_path / "skirt", betas=[2.0, -1.0])
    assert worn.vertices.shape[1:] == moving.vertices.shape[1:] and worn.parameters == {}


def test_the_viewer_serves_its_page(tmp_path):
    with cape.Viewer("female") as viewer:
        page = urllib.request.urlopen(viewer.url, timeout=30).read()
        assert b"<html" in page.lower()
        assert f'<iframe src="{viewer.url}"' in viewer._repr_html_()
    assert "closed" in viewer._repr_html_()
    with pytest.raises(cape.CapeError, match="nowhere"):
        cape.Viewer("nowhere")
    with pytest.raises(OSError):
        urllib.request.urlopen(viewer.url, timeout=5)


class Host(http.server.SimpleHTTPRequestHandler):
    """A page, and an image that keeps it loading while the viewer gets its body."""

    def do_GET(self):
        if self.path == "/wait.png":
            time.sleep(8)
        super().do_GET()

    def log_message(self, *arguments):
        pass


def test_the_viewer_of_a_model_is_shown_in_a_frame(run, tmp_path):
    with cape.Model.load(run).view() as viewer:
        (tmp_path / "page.html").write_text(
            f"<body style='margin:0'>{viewer._repr_html_()}<img src='wait.png' alt=''>"
        )
        # The page is of another origin than the frame, by its port, as that of a notebook is.
        handler = functools.partial(Host, directory=tmp_path)
        with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            address = f"http://127.0.0.1:{server.server_port}/page.html"
            shot = screenshot(address, tmp_path, 1000, 640, 20)
            server.shutdown()
    # Skin and cloth have colours, the studio is grey.
    picture = shot[60:560, 50:650].astype(int)
    coloured = np.ptp(picture, axis=-1) > 30
    assert 0.03 < coloured.mean() < 0.5


def test_a_viewer_ends_with_python():
    code = (
        "import cape, os\nviewer = cape.Viewer('female')\n"
        "print(viewer._finish.peek()[2][0].pid, flush=True)"
    )
    line = [sys.executable, "-c", code]
    pid = int(subprocess.run(line, capture_output=True, text=True, check=True, timeout=60).stdout)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
