"""Opens an animation of `cape animate` with Pixar's USD and Meshcapade's codec of .smpl files.

usage: python usd_and_smpl.py DIRECTORY

DIRECTORY has usda/ and smpl/, the same motion in each format, with animation.json beside it.
"""

import json
import pathlib
import sys

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel
from smplcodec import SMPLCodec

VERTICES, JOINTS = 6890, 24


def report_of(directory):
    return json.loads((directory / "animation.json").read_text())


def expect_usd(directory):
    report = report_of(directory)
    stage = Usd.Stage.Open(str(directory / "animation.usda"))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    rate = stage.GetTimeCodesPerSecond()
    assert abs(rate - report["frames_per_second"]) < 1e-6, rate
    length = (stage.GetEndTimeCode() - stage.GetStartTimeCode()) / rate
    assert abs(length - (report["frames"] - 1) / report["frames_per_second"]) < 1e-3, length
    prims = list(stage.Traverse())
    of = lambda kind: next(prim for prim in prims if prim.IsA(kind))
    mesh = UsdGeom.Mesh(of(UsdGeom.Mesh))
    assert len(mesh.GetPointsAttr().Get()) == VERTICES
    assert set(mesh.GetFaceVertexCountsAttr().Get()) == {3}
    targets = UsdSkel.BindingAPI(mesh).GetBlendShapesAttr().Get()
    assert len(targets) == report["keyframes"], (len(targets), report)
    skeleton = UsdSkel.Skeleton(of(UsdSkel.Skeleton))
    assert len(skeleton.GetJointsAttr().Get()) == JOINTS
    cache = UsdSkel.Cache()
    query = cache.GetSkelQuery(skeleton)
    transforms = query.ComputeSkinningTransforms(stage.GetEndTimeCode())
    assert len(transforms) == JOINTS and np.isfinite(np.array(transforms)).all()
    animation = query.GetAnimQuery()
    samples = animation.GetJointTransformTimeSamples()
    assert len(samples) == report["frames"], len(samples)


def expect_smpl(directory):
    report = report_of(directory)
    codec = SMPLCodec.from_file(str(directory / "animation.smpl"))
    codec.validate()
    assert codec.frame_count == report["frames"], codec.frame_count
    assert abs(codec.frame_rate - report["frames_per_second"]) < 1e-4, codec.frame_rate
    assert codec.body_pose.shape == (report["frames"], JOINTS, 3)
    assert codec.vertex_offsets.shape == (VERTICES, 3) and np.abs(codec.vertex_offsets).max() > 1e-3
    assert np.allclose(codec.shape_parameters[: len(report["betas"])], report["betas"], atol=1e-6)


def main():
    place = pathlib.Path(sys.argv[1])
    expect_usd(place / "usda")
    expect_smpl(place / "smpl")
    print("USD and smplcodec: usda and smpl as expected")


if __name__ == "__main__":
    main()
