//! Rotations of joints in the shapes and representations of files.

use glam::{DMat3, DQuat, DVec3};
use ndarray::{Array2, ArrayD};

/// Representation of a rotation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RotationForm {
    /// Axis times angle, radians.
    AxisAngle,
    /// Matrix, row-major.
    Matrix,
    /// First two rows of the matrix.
    SixNumbers,
}

/// Layout of an array of rotations, `[people?, frames?, joints, …]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct RotationLayout {
    pub(super) people: usize,
    pub(super) frames: usize,
    pub(super) joints: usize,
    form: RotationForm,
}

impl RotationLayout {
    /// Layout of an array of `shape` with one of the numbers of joints `known`.
    pub(super) fn of(shape: &[usize], known: &[usize]) -> Option<Self> {
        let joints = |count: usize| known.contains(&count).then_some(count);
        let flat = |numbers: usize, each: usize| {
            numbers.is_multiple_of(each).then(|| joints(numbers / each))?
        };
        let (lead, joints, form) = match shape {
            [lead @ .., count, 3, 3] if joints(*count).is_some() => {
                (lead, *count, RotationForm::Matrix)
            }
            [lead @ .., count, 3] if joints(*count).is_some() => {
                (lead, *count, RotationForm::AxisAngle)
            }
            [lead @ .., count, 6] if joints(*count).is_some() => {
                (lead, *count, RotationForm::SixNumbers)
            }
            [lead @ .., numbers] => {
                if let Some(count) = flat(*numbers, 3) {
                    (lead, count, RotationForm::AxisAngle)
                } else {
                    (lead, flat(*numbers, 9)?, RotationForm::Matrix)
                }
            }
            [] => return None,
        };
        let (people, frames) = people_and_frames(lead)?;
        Some(Self { people, frames, joints, form })
    }

    /// Layout of an array of the root's rotation, `[3]`, `[n, 3]`, `[n, 1, 3]`, `[n, 3, 3]`, ….
    pub(super) fn of_root(array: &ArrayD<f64>) -> Option<Self> {
        let (lead, form) = match array.shape() {
            // Three axis-angles, or a matrix?
            [3, 3] if is_rotation(array.iter().copied()) => (&[][..], RotationForm::Matrix),
            [lead @ .., 3, 3] if !lead.is_empty() => (lead, RotationForm::Matrix),
            [lead @ .., 9] => (lead, RotationForm::Matrix),
            [lead @ .., 3] => (lead, RotationForm::AxisAngle),
            [lead @ .., 6] => (lead, RotationForm::SixNumbers),
            _ => return None,
        };
        let (people, frames) = people_and_frames(lead)?;
        Some(Self { people, frames, joints: 1, form })
    }

    /// Axis-angles of one person, radians, `[frames, 3 · joints]`; an error if a matrix is no
    /// rotation.
    pub(super) fn axis_angles(
        &self,
        array: &ArrayD<f64>,
        person: usize,
    ) -> Result<Array2<f64>, String> {
        let size = match self.form {
            RotationForm::AxisAngle => 3,
            RotationForm::Matrix => 9,
            RotationForm::SixNumbers => 6,
        };
        let own = self.frames * self.joints * size;
        let numbers = array.iter().copied().skip(person * own).take(own);
        if self.form == RotationForm::AxisAngle {
            return Array2::from_shape_vec((self.frames, 3 * self.joints), numbers.collect())
                .map_err(|error| error.to_string());
        }
        let numbers: Vec<f64> = numbers.collect();
        let mut angles = Vec::with_capacity(3 * self.frames * self.joints);
        for (index, row) in numbers.chunks_exact(size).enumerate() {
            let rotation = orthonormal(row).ok_or_else(|| {
                format!(
                    "the matrix of joint {} in frame {} is no rotation",
                    index % self.joints,
                    index / self.joints
                )
            })?;
            angles.extend(rotation.to_scaled_axis().to_array());
        }
        Array2::from_shape_vec((self.frames, 3 * self.joints), angles)
            .map_err(|error| error.to_string())
    }
}

/// Numbers of people and frames of leading axes.
pub(super) fn people_and_frames(lead: &[usize]) -> Option<(usize, usize)> {
    match lead {
        [] => Some((1, 1)),
        // An estimator's batch of single frames.
        [frames] | [frames, 1] => Some((1, *frames)),
        [people, frames] => Some((*people, *frames)),
        _ => None,
    }
}

/// Rotation of a matrix in 9 numbers, or of its first two rows in 6.
fn orthonormal(numbers: &[f64]) -> Option<DQuat> {
    /// Largest deviation of an entry of R Rᵀ from the identity.
    const TOLERANCE: f64 = 0.02;
    let row = |at: usize| DVec3::from_slice(&numbers[3 * at..]);
    let x = row(0).try_normalize()?;
    let y = (row(1) - x * row(1).dot(x)).try_normalize()?;
    let z = x.cross(y);
    if numbers.len() == 9 {
        let near = |a: DVec3, b: DVec3| (a - b).abs().max_element() < TOLERANCE;
        if !(near(row(0), x) && near(row(1), y) && near(row(2), z)) {
            return None;
        }
    }
    let rotation = DQuat::from_mat3(&DMat3::from_cols(x, y, z).transpose());
    Some(if rotation.w < 0.0 { -rotation } else { rotation })
}

fn is_rotation(numbers: impl Iterator<Item = f64>) -> bool {
    orthonormal(&numbers.collect::<Vec<_>>()).is_some()
}
