use cape_data::PackedSet;
use cape_infer::Run;
use glam::DVec3;
use ndarray::{Array2, Axis};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

use super::BenchmarkOptions;
use crate::{
    Keypoint, KeypointLayout, Keypoints, Mask, PinholeCamera, Result, alignment::points,
    silhouette::render,
};

/// Translation of the bodies in the frame of the camera, metres.
const PLACE: DVec3 = DVec3::new(0.0, 0.15, -3.3);
/// Number of random shape coefficients.
const SHAPES: usize = 4;

/// Observations of a frame and its ground truth.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Camera.
    pub camera: PinholeCamera,
    /// Keypoints of the simulated detector.
    pub keypoints: Keypoints,
    /// Silhouette.
    pub mask: Mask,
    /// Vertices of the true clothed surface, metres, `[V]`.
    pub truth: Vec<DVec3>,
}

impl Scene {
    /// Scene of a frame on a body of rest shape `shape`, `[V, 3]`, or a random one; random numbers depend
    /// on the seed and the frame only.
    pub(super) fn new(
        run: &Run,
        set: &PackedSet,
        frame: usize,
        shape: Option<&Array2<f64>>,
        options: &BenchmarkOptions,
    ) -> Result<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        rng.set_stream(frame as u64);
        let camera = PinholeCamera::new(options.side, options.side, None)?;
        let (displacement, wearer) = cape_infer::registration(set, frame)?;
        let displacement = displacement.index_axis(Axis(0), 0).mapv(f64::from);
        let body = run.body();
        let shapes = SHAPES.min(body.betas());
        let betas: Vec<f64> = (0..shapes).map(|_| rng.sample(StandardNormal)).collect();
        let rest = match shape {
            Some(shape) => shape.clone(),
            None => body.rest_shape(&betas)?,
        };
        let pose = wearer.pose.map(f64::from);
        let posed = body.pose_shape(&rest, &pose, PLACE.to_array(), Some(&displacement))?;
        let truth = points(posed.vertices.view());
        let joints = detected_joints(&points(posed.joints.view()), options.bias);
        let detector = KeypointLayout::Body25;
        let unseen = Keypoint { x: 0.0, y: 0.0, confidence: 0.0 };
        let mut found = vec![unseen; detector.points()];
        for &(point, joint) in detector.joints() {
            let at = camera.project(joints[joint]);
            let [dx, dy] = [0; 2].map(|_| options.noise * rng.sample::<f64, _>(StandardNormal));
            if rng.random::<f64>() >= options.dropped {
                found[point] = Keypoint { x: at.x + dx, y: at.y + dy, confidence: 1.0 };
            }
        }
        let mask = render(&truth, &body.faces, &camera)?.mask().clone();
        let mask = perturb_outline(&mask, options.ragged, &mut rng)?;
        Ok(Self { camera, keypoints: Keypoints::new(detector, found)?, mask, truth })
    }
}

/// Joints as a detector that was trained on people's annotations finds them: hips outwards and upwards
/// of SMPL's, the neck below, by `bias` metres.
fn detected_joints(joints: &[DVec3], bias: f64) -> Vec<DVec3> {
    let [pelvis, left_hip, right_hip, spine, chest, neck] = [0, 1, 2, 3, 9, 12];
    let along = |from: usize, to: usize| (joints[to] - joints[from]).normalize_or_zero();
    let left = along(right_hip, left_hip);
    let up = along(pelvis, spine);
    let mut detected = joints.to_vec();
    for (hip, outwards) in [(left_hip, left), (right_hip, -left)] {
        detected[hip] += bias * (outwards + up).normalize_or_zero();
    }
    detected[neck] -= bias * along(chest, neck);
    detected
}

/// The mask with the share `share` of the pixels beside its outline flipped.
fn perturb_outline(mask: &Mask, share: f64, rng: &mut ChaCha8Rng) -> Result<Mask> {
    let (width, height) = (mask.width() as usize, mask.height() as usize);
    let inside = mask.covered();
    let mut covered = inside.to_vec();
    for y in 0..height {
        for x in 0..width {
            let at = y * width + x;
            let differs = |other: usize| inside[other] != inside[at];
            let edge = (x > 0 && differs(at - 1))
                || (x + 1 < width && differs(at + 1))
                || (y > 0 && differs(at - width))
                || (y + 1 < height && differs(at + width));
            if edge && rng.random::<f64>() < share {
                covered[at] = !inside[at];
            }
        }
    }
    Mask::new(mask.width(), mask.height(), covered)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn detected_hips_are_wider_and_the_neck_is_lower() {
        let joints: Vec<DVec3> = crate::Skeleton::new(&crate::testing::BODY).unwrap().rest(&[]);
        assert_eq!(detected_joints(&joints, 0.0), joints);
        let detected = detected_joints(&joints, 0.03);
        let width = |joints: &[DVec3]| joints[1].distance(joints[2]);
        assert!(width(&detected) - width(&joints) > 0.03);
        assert!(detected[12].y < joints[12].y - 0.02 && detected[1].y > joints[1].y + 0.01);
        for (joint, (a, b)) in detected.iter().zip(&joints).enumerate() {
            let moved = if [1, 2, 12].contains(&joint) { 0.03 } else { 0.0 };
            assert!((a.distance(*b) - moved).abs() < 1e-9, "{joint}");
        }
    }

    #[test]
    fn only_edges_become_ragged() {
        let covered = (0..40 * 40).map(|at| (10..30).contains(&(at % 40)));
        let mask = Mask::new(40, 40, covered.collect()).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        assert_eq!(perturb_outline(&mask, 0.0, &mut rng).unwrap(), mask);
        let torn = perturb_outline(&mask, 0.5, &mut rng).unwrap();
        let changed = mask.covered().iter().zip(torn.covered()).enumerate();
        let changed: Vec<usize> =
            changed.filter(|(_, (a, b))| a != b).map(|(at, _)| at % 40).collect();
        assert!((50..110).contains(&changed.len()), "{}", changed.len());
        assert!(changed.iter().all(|column| [9, 10, 29, 30].contains(column)));
    }
}
