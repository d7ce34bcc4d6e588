//! The motion of one person as read from a file.

use ndarray::{Array2, s};

use super::{Pivot, positions::are_positions};
use crate::joints::JOINTS;

/// Numbers of the joints that all models share.
pub(super) const SHARED: usize = 66;

/// Rotations, translations and shape of one person over frames.
#[derive(Debug, Clone, Default)]
pub(super) struct Clip {
    /// Axis-angles of SMPL's joints, radians, `[frames, 72]`.
    pub(super) poses: Array2<f64>,
    /// Metres, `[frames, 3]`.
    pub(super) translations: Option<Array2<f64>>,
    /// Mean over the frames.
    pub(super) betas: Vec<f64>,
    /// Number of rows that `betas` is the mean of.
    pub(super) shapes: usize,
    pub(super) gender: Option<String>,
    pub(super) frame_rate: Option<f64>,
    /// Number of joints of the file.
    pub(super) joints: usize,
    /// Numbers of things that the body has not, with their names.
    pub(super) left_out: Vec<(&'static str, usize)>,
    /// True for files of AMASS's layout, in which z points up.
    pub(super) amass: bool,
    /// Point about which the root turns.
    pub(super) pivot: Pivot,
    /// Displacements of the rest vertices, metres, `[V, 3]`.
    pub(super) offsets: Option<Array2<f64>>,
    pub(super) notes: Vec<String>,
}

impl Clip {
    /// A clip of axis-angles `[frames, 3 · joints]`.
    pub(super) fn new(joints: usize, rotations: Array2<f64>) -> Result<Self, String> {
        if rotations.nrows() == 0 {
            return Err("holds no pose".into());
        }
        if let Some(at) = rotations.iter().position(|angle| !angle.is_finite()) {
            let (frame, number) = (at / rotations.ncols(), at % rotations.ncols());
            return Err(format!("number {number} of frame {frame} is not finite"));
        }
        let frames = rotations.nrows();
        if are_positions(rotations.view()) {
            return Err(format!(
                "[{frames}, {joints}, 3] are positions of joints, as their distances are those of a \
                 skeleton, not rotations: fit SMPL to them and give its poses"
            ));
        }
        if let Some(angle) = angle_in_degrees(&rotations) {
            return Err(format!(
                "rotations by {angle:.0}: these are degrees, expected radians (`numpy.radians`)"
            ));
        }
        let used = if joints == 24 { 72 } else { SHARED };
        let mut poses = Array2::zeros((frames, 3 * JOINTS));
        poses.slice_mut(s![.., ..used]).assign(&rotations.slice(s![.., ..used]));
        let left_out = match joints {
            52 => vec![("hand joints", 30)],
            55 => vec![("joints of jaw and eyes", 3), ("hand joints", 30)],
            _ => Vec::new(),
        };
        Ok(Self { poses, joints, left_out, ..Self::default() })
    }

    pub(super) fn frames(&self) -> usize {
        self.poses.nrows()
    }
}

/// Largest angle of rotations `[frames, 3 · joints]` that are in degrees, as of those that turn at all
/// many turn by more than a full turn.
fn angle_in_degrees(rotations: &Array2<f64>) -> Option<f64> {
    /// Least share of such rotations, least of their largest angle, and angle from which a rotation
    /// counts as one.
    const SHARE: f64 = 0.2;
    const LEAST: f64 = 10.0;
    const TURNED: f64 = 1e-6;
    let (mut turned, mut beyond) = (0_usize, 0_usize);
    let mut largest: f64 = 0.0;
    for pose in rotations.rows() {
        // The root may have turned several times.
        for joint in 1..pose.len() / 3 {
            let of = |axis: usize| pose[3 * joint + axis];
            let angle = (of(0).powi(2) + of(1).powi(2) + of(2).powi(2)).sqrt();
            turned += usize::from(angle > TURNED);
            beyond += usize::from(angle > std::f64::consts::TAU);
            largest = largest.max(angle);
        }
    }
    (largest > LEAST && beyond as f64 >= SHARE * turned as f64).then_some(largest)
}

/// Each row of a clip as a person of one frame.
pub(super) fn rows(clip: &Clip) -> Vec<Clip> {
    let row =
        |row: usize| Clip { poses: clip.poses.slice(s![row..=row, ..]).to_owned(), ..clip.clone() };
    (0..clip.frames()).map(row).collect()
}
