//! Depth ambiguity of bones in a single image.
//!
//! A bone towards the camera and its mirror image in depth have nearly the same projection: limbs
//! fitted to joints alone may be mirrored, each bone independently.

use glam::{DMat3, DQuat, DVec3};

use crate::{
    Result, Skeleton,
    parameters::{BETAS_AT, POSE_AT, transl},
};

/// Root, middle and end joint of each arm and leg.
pub(crate) const LIMBS: [[usize; 3]; 4] = [[16, 18, 20], [17, 19, 21], [1, 4, 7], [2, 5, 8]];
const NECK: usize = 12;
/// Combinations of mirrored bones, upper and lower, of a limb.
pub(crate) const BONE_FLIPS: [[bool; 2]; 3] = [[true, false], [false, true], [true, true]];

/// The unknowns with bones of one limb mirrored along the line of sight. Joints other than the
/// limb's and their descendants keep their positions.
///
/// # Errors
/// If sizes do not fit the body.
pub(crate) fn mirror_limb_depths(
    skeleton: &Skeleton,
    x: &[f64],
    betas: usize,
    [root, middle, end]: [usize; 3],
    [upper, lower]: [bool; 2],
) -> Result<Vec<f64>> {
    let (pose, shape) = (&x[POSE_AT..BETAS_AT], &x[BETAS_AT..BETAS_AT + betas]);
    let posed = skeleton.pose(shape, pose, transl(x))?;
    let (joints, rotations) = (posed.joints(), posed.rotations());
    let turn = |from: usize, to: usize, flip: bool| {
        let bone = (joints[to] - joints[from]).normalize_or(DVec3::Y);
        let sight = (joints[to] + joints[from]).normalize_or(DVec3::NEG_Z);
        let mirrored = if flip { bone - 2.0 * bone.dot(sight) * sight } else { bone };
        DMat3::from_quat(DQuat::from_rotation_arc(bone, mirrored)) * rotations[from]
    };
    let (first, second) = (turn(root, middle, upper), turn(middle, end, lower));
    let above = skeleton.parent(root).map_or(DMat3::IDENTITY, |parent| rotations[parent]);
    let mut moved = x.to_vec();
    for (joint, parent, rotation) in [(root, above, first), (middle, first, second)] {
        let local = DQuat::from_mat3(&(parent.transpose() * rotation)).to_scaled_axis();
        moved[POSE_AT + 3 * joint..][..3].copy_from_slice(&local.to_array());
    }
    Ok(moved)
}

/// The unknowns with the trunk mirrored along the line of sight about the pelvis, which turns
/// leaning back into bending forward. Limbs keep their directions.
///
/// # Errors
/// If sizes do not fit the body.
pub(crate) fn mirror_trunk_lean(skeleton: &Skeleton, x: &[f64], betas: usize) -> Result<Vec<f64>> {
    let (pose, shape) = (&x[POSE_AT..BETAS_AT], &x[BETAS_AT..BETAS_AT + betas]);
    let posed = skeleton.pose(shape, pose, transl(x))?;
    let (joints, rotations) = (posed.joints(), posed.rotations());
    let bone = (joints[NECK] - joints[0]).normalize_or(DVec3::Y);
    let sight = (joints[NECK] + joints[0]).normalize_or(DVec3::NEG_Z);
    let turn = DQuat::from_rotation_arc(bone, bone - 2.0 * bone.dot(sight) * sight);
    let turn = DMat3::from_quat(turn);
    let mut moved = x.to_vec();
    let mut set = |joint: usize, local: DMat3| {
        let angles = DQuat::from_mat3(&local).to_scaled_axis().to_array();
        moved[POSE_AT + 3 * joint..][..3].copy_from_slice(&angles);
    };
    set(0, turn * rotations[0]);
    for [root, ..] in LIMBS {
        if let Some(parent) = skeleton.parent(root) {
            set(root, (turn * rotations[parent]).transpose() * rotations[root]);
        }
    }
    Ok(moved)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

    use super::*;
    use crate::{PinholeCamera, testing::BODY};

    #[test]
    fn mirrored_limbs_look_alike_and_go_the_other_way() {
        let skeleton = Skeleton::new(&BODY).unwrap();
        // At a distance where perspective is negligible.
        let camera = PinholeCamera::new(500, 500, Some(10_000.0)).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let mut x: Vec<f64> = (0..3 + 72 + 2).map(|_| rng.random_range(-0.5..0.5)).collect();
        x[2] = -60.0;
        let at =
            |x: &[f64]| skeleton.pose(&x[75..], &x[3..75], transl(x)).unwrap().joints().to_vec();
        let before = at(&x);
        for limb in LIMBS {
            for which in BONE_FLIPS {
                let after = at(&mirror_limb_depths(&skeleton, &x, 2, limb, which).unwrap());
                for joint in limb {
                    let [a, b] = [&before, &after].map(|joints| camera.project(joints[joint]));
                    assert!((a - b).length() < 0.6, "{limb:?} {which:?}: {a} {b}");
                }
                for (bone, flip) in [(0, which[0]), (1, which[1])] {
                    let depth = |joints: &[DVec3]| joints[limb[bone + 1]].z - joints[limb[bone]].z;
                    let expected = if flip { -depth(&before) } else { depth(&before) };
                    assert!((depth(&after) - expected).abs() < 0.01, "{limb:?} {which:?}");
                }
                let others = (0..24).filter(|joint| ![limb[1], limb[2]].contains(joint));
                for joint in others.filter(|&joint| !hangs(joint, limb[1], &skeleton)) {
                    assert!((before[joint] - after[joint]).length() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn a_mirrored_trunk_leans_the_other_way_and_limbs_stay() {
        let skeleton = Skeleton::new(&BODY).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let mut x: Vec<f64> = (0..3 + 72 + 2).map(|_| rng.random_range(-0.4..0.4)).collect();
        x[2] = -60.0;
        let at =
            |x: &[f64]| skeleton.pose(&x[75..], &x[3..75], transl(x)).unwrap().joints().to_vec();
        let [before, after] = [at(&x), at(&mirror_trunk_lean(&skeleton, &x, 2).unwrap())];
        let lean = |joints: &[DVec3]| joints[NECK].z - joints[0].z;
        assert!((lean(&after) + lean(&before)).abs() < 0.01, "{} {}", lean(&before), lean(&after));
        for [root, middle, end] in LIMBS {
            for (a, b) in [(root, middle), (middle, end)] {
                let bone = |joints: &[DVec3]| joints[b] - joints[a];
                assert!((bone(&before) - bone(&after)).length() < 1e-9);
            }
        }
    }

    fn hangs(mut joint: usize, on: usize, skeleton: &Skeleton) -> bool {
        while let Some(parent) = skeleton.parent(joint) {
            if parent == on {
                return true;
            }
            joint = parent;
        }
        false
    }
}
