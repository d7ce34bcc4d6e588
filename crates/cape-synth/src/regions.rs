//! Garment coordinates of the body's vertices: position along and around limbs and torso, distance
//! from hems. They derive from template, blend weights and rest joints, so that they exist for any
//! body in SMPL's layout.

use glam::DVec3;

use crate::{Error, Result};
use cape_core::SmplModel;

/// Indices of SMPL's joints.
pub(super) mod joint {
    pub(crate) const PELVIS: usize = 0;
    pub(crate) const HIPS: [usize; 2] = [1, 2];
    pub(crate) const SPINE: [usize; 3] = [3, 6, 9];
    pub(crate) const KNEES: [usize; 2] = [4, 5];
    pub(crate) const ANKLES: [usize; 2] = [7, 8];
    pub(crate) const FEET: [usize; 2] = [10, 11];
    pub(crate) const NECK: usize = 12;
    pub(crate) const COLLARS: [usize; 2] = [13, 14];
    pub(crate) const HEAD: usize = 15;
    pub(crate) const SHOULDERS: [usize; 2] = [16, 17];
    pub(crate) const ELBOWS: [usize; 2] = [18, 19];
    pub(crate) const WRISTS: [usize; 2] = [20, 21];
    pub(crate) const HANDS: [usize; 2] = [22, 23];
    pub(crate) const COUNT: usize = 24;
}

/// Ends of the coverable parts of arms and legs, as fractions of the limb length.
const MAX_SLEEVE_END: f64 = 0.95;
const MAX_LEG_END: f64 = 0.935;
/// Blend weight of head, hands or feet above which a vertex is uncovered.
const BARE_WEIGHT: f64 = 0.25;

/// Position of a vertex in the coordinates of an arm or leg.
#[derive(Debug, Clone, Copy)]
pub(super) struct LimbSite {
    /// Position along the limb, 0 at shoulder or hip, 1 at wrist or ankle.
    pub(super) along: f64,
    /// Length of the limb, metres.
    pub(super) length: f64,
    /// Direction of the nearest bone away from the body, unit.
    pub(super) axis: DVec3,
    /// Direction from the bone to the vertex, unit.
    pub(super) radial: DVec3,
    /// Distance from the bone, metres.
    pub(super) radius: f64,
    /// Angle around the bone from the front, radians.
    pub(super) angle: f64,
}

impl LimbSite {
    /// Projects `point` onto the limb with `joints` shoulder, elbow, wrist or hip, knee, ankle.
    fn new(point: DVec3, joints: [DVec3; 3]) -> Self {
        let bones = [joints[1] - joints[0], joints[2] - joints[1]];
        let lengths = bones.map(|bone| bone.length().max(1e-6));
        let length = lengths[0] + lengths[1];
        let project = |bone: usize| {
            let axis = bones[bone] / lengths[bone];
            let mut t = (point - joints[bone]).dot(axis);
            // The bones extend beyond shoulder and wrist and meet at the elbow.
            t = if bone == 0 { t.min(lengths[0]) } else { t.max(0.0) };
            let offset = point - joints[bone] - axis * t;
            (offset.length(), t + if bone == 1 { lengths[0] } else { 0.0 }, axis, offset)
        };
        let (first, second) = (project(0), project(1));
        let (radius, distance, axis, offset) = if first.0 <= second.0 { first } else { second };
        let front = (DVec3::Z - axis * axis.z).normalize_or(DVec3::Z);
        let angle = offset.dot(axis.cross(front)).atan2(offset.dot(front));
        let radial = offset.normalize_or_zero();
        Self { along: distance / length, length, axis, radial, radius, angle }
    }

    /// Tangent around the limb, unit.
    pub(super) fn around(&self) -> DVec3 {
        self.axis.cross(self.radial)
    }
}

/// Garment coordinates of a vertex of the rest body.
#[derive(Debug, Clone)]
pub(super) struct VertexSite {
    pub(super) position: DVec3,
    pub(super) normal: DVec3,
    /// Body side: 0 left (+x), 1 right.
    pub(super) side: usize,
    /// Sums of the blend weights of this side's arm and leg.
    pub(super) arm_weight: f64,
    pub(super) leg_weight: f64,
    pub(super) arm: LimbSite,
    pub(super) leg: LimbSite,
    /// Height on the torso: 0 at the pelvis, 1 at the neck.
    pub(super) height: f64,
    /// Angle around the vertical axis of the torso, radians, 0 in front, positive to the left.
    pub(super) angle: f64,
    /// Mean length of the edges at the vertex, metres.
    pub(super) edge: f64,
    /// Four joints of largest blend weight with their weights, in descending order.
    pub(super) bones: [(usize, f64); 4],
    /// True if garments may cover the vertex: all but head, hands and feet.
    pub(super) clothed: bool,
}

/// Garment coordinates of all vertices, and the rest joints, metres.
#[derive(Debug, Clone)]
pub(super) struct Regions {
    pub(super) sites: Vec<VertexSite>,
    pub(super) joints: Vec<DVec3>,
}

impl Regions {
    pub(super) fn new(model: &SmplModel) -> Result<Self> {
        if model.joints() != joint::COUNT {
            return Err(Error::Argument(format!(
                "body of {} joints: garments need SMPL's {}",
                model.joints(),
                joint::COUNT
            )));
        }
        let points: Vec<DVec3> =
            model.v_template.rows().into_iter().map(|v| DVec3::new(v[0], v[1], v[2])).collect();
        let joints: Vec<DVec3> = model
            .joint_regressor
            .dot(&model.v_template)
            .rows()
            .into_iter()
            .map(|j| DVec3::new(j[0], j[1], j[2]))
            .collect();
        let around = normals(&points, &model.faces).into_iter().zip(edges(&points, &model.faces));
        let sites = points
            .iter()
            .zip(around)
            .zip(model.weights.rows())
            .map(|((&point, (normal, edge)), weights)| {
                site(point, normal, edge, &weights.to_vec(), &joints)
            })
            .collect();
        Ok(Self { sites, joints })
    }
}

fn site(
    position: DVec3,
    normal: DVec3,
    edge: f64,
    weights: &[f64],
    joints: &[DVec3],
) -> VertexSite {
    let side = usize::from(position.x < joints[joint::PELVIS].x);
    let limb =
        |names: [[usize; 2]; 3]| LimbSite::new(position, names.map(|name| joints[name[side]]));
    let sum = |names: &[[usize; 2]]| -> f64 { names.iter().map(|n| weights[n[side]]).sum() };
    let arm = limb([joint::SHOULDERS, joint::ELBOWS, joint::WRISTS]);
    let leg = limb([joint::HIPS, joint::KNEES, joint::ANKLES]);
    let arm_weight = sum(&[joint::SHOULDERS, joint::ELBOWS, joint::WRISTS, joint::HANDS]);
    let leg_weight = sum(&[joint::HIPS, joint::KNEES, joint::ANKLES, joint::FEET]);

    let (pelvis, neck) = (joints[joint::PELVIS], joints[joint::NECK]);
    let height = (position.y - pelvis.y) / (neck.y - pelvis.y).max(1e-6);
    let axis = pelvis.lerp(neck, height.clamp(0.0, 1.0));
    let angle = (position.x - axis.x).atan2(position.z - axis.z);

    let neckline = neck.lerp(joints[joint::HEAD], 0.35).y;
    let above = position.y > neckline && arm_weight < 0.5;
    let hand = arm_weight > 0.5 && arm.along > MAX_SLEEVE_END;
    let foot = leg_weight > 0.5 && leg.along > MAX_LEG_END;
    let bare = weights[joint::HEAD]
        .max(sum(&[joint::HANDS]) + sum(&[joint::WRISTS]) * 0.4)
        .max(sum(&[joint::FEET]) + sum(&[joint::ANKLES]) * 0.4);

    let mut bones: Vec<(usize, f64)> = weights.iter().copied().enumerate().collect();
    bones.sort_by(|a, b| b.1.total_cmp(&a.1));
    let bones = std::array::from_fn(|i| bones[i]);
    VertexSite {
        position,
        normal,
        side,
        arm_weight,
        leg_weight,
        arm,
        leg,
        height,
        angle,
        edge,
        bones,
        clothed: !(above || hand || foot || bare > BARE_WEIGHT),
    }
}

/// Area-weighted unit normals of the vertices.
fn normals(points: &[DVec3], faces: &[[u32; 3]]) -> Vec<DVec3> {
    let mut normals = vec![DVec3::ZERO; points.len()];
    for face in faces {
        let [a, b, c] = face.map(|i| points[i as usize]);
        for i in face {
            normals[*i as usize] += (b - a).cross(c - a);
        }
    }
    normals.into_iter().map(DVec3::normalize_or_zero).collect()
}

/// Mean length of the edges at each vertex, metres.
fn edges(points: &[DVec3], faces: &[[u32; 3]]) -> Vec<f64> {
    let mut sums = vec![(0.0, 0); points.len()];
    for face in faces {
        for (from, to) in [(0, 1), (1, 2), (2, 0)] {
            let (from, to) = (face[from] as usize, face[to] as usize);
            let length = points[from].distance(points[to]);
            for end in [from, to] {
                sums[end].0 += length;
                sums[end].1 += 1;
            }
        }
    }
    sums.into_iter().map(|(sum, count)| sum / f64::from(count.max(1))).collect()
}
