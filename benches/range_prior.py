"""Poses drawn from the normal ranges of motion of single joints, for a pose prior that has seen no motion.

usage: python range_prior.py POSES.npy
       cape fit pose-prior POSES.npy --components 1 --floor 0.001 --out ranges.npz

Ranges in degrees follow the normal values of the American Academy of Orthopaedic Surgeons (Joint Motion,
1965), rounded, where they have the axis; those of collar bones, feet, hands and of knees and elbows off
their axis are small numbers of our own. Joints are independent and normal about the middle of their range,
with a quarter of the range as deviation; shoulders are about arms lowered by 45 degrees. Ranges of the
spine are shared by its three joints, those of the neck by neck and head.
"""

import sys

import numpy as np

# Joint of the left or of the middle: (least, most) about x, y and z of SMPL's T-pose.
# About x: flexion of the spine and of the knee is positive, of the hip negative. About y: towards the
# left is positive. About z: abduction of a left limb is positive.
RANGES = {
    1: ((-120, 30), (-45, 45), (-30, 45)),  # hip
    4: ((0, 135), (-10, 10), (-5, 5)),  # knee
    7: ((-20, 50), (-20, 20), (-30, 20)),  # ankle
    10: ((-20, 20), (-5, 5), (-5, 5)),  # foot
    3: ((-10, 27), (-15, 15), (-12, 12)),  # spine, a third
    6: ((-10, 27), (-15, 15), (-12, 12)),
    9: ((-10, 27), (-15, 15), (-12, 12)),
    12: ((-22, 22), (-30, 30), (-22, 22)),  # neck, a half
    15: ((-22, 22), (-30, 30), (-22, 22)),
    13: ((-5, 5), (-15, 15), (-10, 20)),  # collar
    16: ((-70, 90), (-135, 45), (-135, 45)),  # shoulder
    18: ((-80, 80), (-150, 0), (-5, 5)),  # elbow
    20: ((-10, 10), (-30, 20), (-70, 80)),  # wrist
    22: ((-5, 5), (-5, 5), (-5, 5)),  # hand
}
POSES = 20_000


def main(path):
    random = np.random.default_rng(1)
    poses = np.zeros((POSES, 24, 3))
    for joint, ranges in RANGES.items():
        low, high = np.radians(np.array(ranges, float)).T
        middle, deviation = (low + high) / 2, (high - low) / 4
        sides = [(joint, 1)] if joint in (3, 6, 9, 12, 15) else [(joint, 1), (joint + 1, -1)]
        for place, side in sides:
            # The mirror image turns the other way about y and z.
            mirror = np.array([1, side, side])
            poses[:, place] = mirror * middle + deviation * random.standard_normal((POSES, 3))
    np.save(path, poses.reshape(POSES, 72))


main(sys.argv[1])
