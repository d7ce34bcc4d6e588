//! Known joint positions in the frame of a scan.

use std::path::Path;

use cape_core::{joints::JOINTS, npy::read_f64};
use glam::DVec3;

use crate::{
    Error, Result, Skeleton,
    body_energy::geman_mcclure,
    parameters::{BETAS_AT, POSE_AT, transl},
};

/// Fewest known joints that place a body.
const FEWEST: usize = 4;
/// Geman–McClure scale σ (outlier threshold) in standard deviations.
const ROBUST: f64 = 6.0;

/// Known joint positions in the frame of a scan.
///
/// ```
/// use cape_synth::synthetic_body;
/// use cape_fit::{Skeleton, scan::KnownJoints};
///
/// let joints = Skeleton::new(&synthetic_body())?.rest(&[]);
/// let mut known: Vec<_> = joints.into_iter().map(Some).collect();
/// // All joints but the hands are known.
/// known[22..].fill(None);
/// assert!(KnownJoints::new(&known).is_ok());
/// // One joint is too few.
/// known[1..].fill(None);
/// assert!(KnownJoints::new(&known).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct KnownJoints(Vec<(usize, DVec3)>);

impl KnownJoints {
    /// Positions of SMPL's 24 joints, metres; `None` if unknown.
    ///
    /// # Errors
    /// If there are not 24, or fewer than 4 are known.
    pub fn new(joints: &[Option<DVec3>]) -> Result<Self> {
        if joints.len() != JOINTS {
            return Err(Error::Observation(format!(
                "joints: {} joints, expected SMPL's {JOINTS}",
                joints.len()
            )));
        }
        let known = joints.iter().enumerate();
        let known: Vec<_> = known.filter_map(|(joint, at)| Some((joint, (*at)?))).collect();
        if known.len() < FEWEST {
            return Err(Error::Observation(format!(
                "joints: {} joints are known, expected at least {FEWEST}",
                known.len()
            )));
        }
        Ok(Self(known))
    }

    /// Reads positions `[24, 3]`, metres, from `.npy` or JSON; joints with a non-finite number or
    /// `null` are unknown.
    ///
    /// # Errors
    /// If the file is malformed, or as of [`new`](Self::new).
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let rows: Vec<Vec<f64>> = if path.extension().is_some_and(|is| is == "npy") {
            let array = read_f64(path)?;
            let width = array.shape().last().copied().unwrap_or(0).max(1);
            let values: Vec<f64> = array.iter().copied().collect();
            values.chunks(width).map(<[f64]>::to_vec).collect()
        } else {
            let text = std::fs::read(path).map_err(|source| Error::io(path, source))?;
            let rows: Vec<Vec<Option<f64>>> = serde_json::from_slice(&text).map_err(|error| {
                Error::format(path, format!("expected a list of 24 positions [x, y, z]: {error}"))
            })?;
            let number = |x: Option<f64>| x.unwrap_or(f64::NAN);
            rows.into_iter().map(|row| row.into_iter().map(number).collect()).collect()
        };
        let mut joints = Vec::with_capacity(rows.len());
        for (index, row) in rows.iter().enumerate() {
            let &[x, y, z] = &row[..] else {
                let message = format!("{} numbers, expected 3", row.len());
                return Err(Error::field(path, format!("joint {index}"), message));
            };
            let at = DVec3::new(x, y, z);
            joints.push(at.is_finite().then_some(at));
        }
        Self::new(&joints).map_err(|error| Error::format(path, error.to_string()))
    }

    /// Positions multiplied by `metres`, the length of their unit.
    #[must_use]
    pub fn scaled(&self, metres: f64) -> Self {
        Self(self.0.iter().map(|&(joint, at)| (joint, at * metres)).collect())
    }

    /// Indices and positions, metres, of the known joints.
    pub(crate) fn positions(&self) -> &[(usize, DVec3)] {
        &self.0
    }

    /// Half the robust squared errors in units of `deviation`, metres, at the unknowns `[3 + 72 +
    /// betas, …]`; `scale` times the gradient is added to `gradient`.
    ///
    /// # Errors
    /// If sizes do not fit the body.
    pub(crate) fn energy(
        &self,
        skeleton: &Skeleton,
        x: &[f64],
        betas: usize,
        deviation: f64,
        scale: f64,
        gradient: &mut [f64],
    ) -> Result<f64> {
        let (pose, betas) = (&x[POSE_AT..BETAS_AT], &x[BETAS_AT..BETAS_AT + betas]);
        let posed = skeleton.pose(betas, pose, transl(x))?;
        let mut forces = vec![DVec3::ZERO; posed.joints().len()];
        let weight = 0.5 / (deviation * deviation);
        let mut energy = 0.0;
        for &(joint, at) in &self.0 {
            let off = posed.joints()[joint] - at;
            let (penalty, slope) = geman_mcclure(off.length_squared(), ROBUST * deviation);
            energy += weight * penalty;
            forces[joint] += off * (2.0 * weight * slope * scale);
        }
        let by = posed.pull_back(&forces);
        let parts = by.transl.to_array().into_iter().chain(by.pose).chain(by.betas);
        gradient.iter_mut().zip(parts).for_each(|(g, part)| *g += part);
        Ok(energy)
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

    use super::*;
    use crate::testing::{BODY, assert_gradient};

    #[test]
    fn gradients_agree_with_finite_differences() {
        let skeleton = Skeleton::new(&BODY).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut random = |size: f64| rng.random_range(-size..size);
        let joints: Vec<Option<DVec3>> = skeleton
            .rest(&[])
            .iter()
            .enumerate()
            .map(|(i, &at)| (i % 5 != 0).then(|| at + DVec3::new(random(0.1), random(0.1), 0.0)))
            .collect();
        let joints = KnownJoints::new(&joints).unwrap();
        let x: Vec<f64> = (0..3 + 72 + 10).map(|_| random(0.2)).collect();
        let mut gradient = vec![0.0; x.len()];
        joints.energy(&skeleton, &x, 10, 0.05, 0.7, &mut gradient).unwrap();
        assert_gradient(&x, &gradient, 1e-6, |x| {
            0.7 * joints.energy(&skeleton, x, 10, 0.05, 0.7, &mut vec![0.0; x.len()]).unwrap()
        });
    }

    #[test]
    fn malformed_files_name_the_joint() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("joints.json");
        let load = |text: String| {
            std::fs::write(&path, text).unwrap();
            KnownJoints::load(&path)
        };
        let rows = |count: usize, row: &str| format!("[{}]", vec![row; count].join(","));
        assert_eq!(load(rows(24, "[1,2,3]")).unwrap().positions().len(), 24);
        let some = rows(24, "[1,2,3]").replacen("[1,2,3]", "[null,2,3]", 3);
        assert_eq!(load(some).unwrap().positions().len(), 21);
        let message = |text| load(text).unwrap_err().to_string();
        assert!(message(rows(23, "[1,2,3]")).contains("23 joints"));
        assert!(message(rows(24, "[1,2]")).contains("joint 0"));
        assert!(message(rows(24, "[1,2,null]")).contains("0 joints are known"));
        assert!(message("{".into()).contains("joints.json"));
        let path = directory.path().join("joints.npy");
        cape_core::npy::write_npy(&path, &ndarray::Array2::<f64>::ones((24, 3))).unwrap();
        let loaded = KnownJoints::load(&path).unwrap().scaled(0.5);
        assert_eq!(loaded.positions()[3], (3, DVec3::splat(0.5)));
    }
}
