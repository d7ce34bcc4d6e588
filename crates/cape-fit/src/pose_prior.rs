//! Pose prior: a Gaussian mixture in max-mixture form (SMPLify, Bogo et al. 2016).

use std::path::Path;

use cape_core::{
    npy::{Npz, NpzWriter},
    pickle::{Pickle, Value},
};
use cape_stats::density::{Mixture, MixtureOptions};
use cape_synth::{Motion, MotionStyle};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use ndarray::{Array1, Array2, Array3, ArrayD, ArrayView2, Axis, Dimension, s};
use rand::{SeedableRng, rngs::ChaCha8Rng};

use crate::{Error, Result};

/// Length of a body pose without the global orientation: 23 axis-angles.
pub const BODY_POSE: usize = 69;

/// Number of components of the default prior, as in SMPLify.
pub const COMPONENTS: usize = 8;

/// Options of the default prior. The regularisation is a lower bound of the variances, which lets
/// joints that hardly move in the training poses move a little.
pub const OPTIONS: MixtureOptions =
    MixtureOptions { steps: 60, tolerance: 1e-2, regularisation: 0.1, starts: 1, seed: 1 };

/// Styles of each motion for the default prior, and poses of each style.
const STYLES: u64 = 6;
const INSTANTS: u32 = 12;

/// Pose prior `E_θ = min_j (−log(c g_j N(θ; μ_j, Σ_j)))` over body poses θ `[69]`, radians, with the
/// constant `c` that makes the lowest energy 0.
///
/// ```
/// use cape_fit::{BODY_POSE, PosePrior};
/// use ndarray::{Array1, Array2, Array3};
///
/// // One standard normal distribution.
/// let means = Array2::zeros((1, BODY_POSE));
/// let unit = Array3::from_shape_fn((1, BODY_POSE, BODY_POSE), |(_, i, j)| f64::from(i == j));
/// let prior = PosePrior::new(Array1::ones(1), means, unit)?;
/// let (mut pose, mut gradient) = (vec![0.0; BODY_POSE], vec![0.0; BODY_POSE]);
/// pose[3] = 2.0;
/// assert!((prior.energy(&pose, 1.0, &mut gradient) - 2.0).abs() < 1e-9);
/// assert!((gradient[3] - 2.0).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct PosePrior {
    components: Vec<Component>,
    weights: Array1<f64>,
    means: Array2<f64>,
    covariances: Array3<f64>,
}

#[derive(Debug, Clone)]
struct Component {
    mean: DVector<f64>,
    factor: Cholesky<f64, Dyn>,
    /// `−log g_j + ½ log |Σ_j|`, minus its least value over the components.
    offset: f64,
}

impl PosePrior {
    /// A prior with weights `g` `[components]`, means `μ` `[components, 69]` and covariances `Σ`
    /// `[components, 69, 69]`.
    ///
    /// # Errors
    /// If shapes differ, weights do not sum to 1, or a covariance is not positive definite.
    pub fn new(weights: Array1<f64>, means: Array2<f64>, covariances: Array3<f64>) -> Result<Self> {
        if means.ncols() != BODY_POSE {
            return Err(Error::argument(format!(
                "pose prior: means {:?}, expected [components, {BODY_POSE}]",
                means.shape()
            )));
        }
        Mixture::new(&weights, &means, &covariances)?;
        let mut components = Vec::with_capacity(weights.len());
        for ((&weight, mean), covariance) in
            weights.iter().zip(means.rows()).zip(covariances.axis_iter(Axis(0)))
        {
            let matrix = DMatrix::from_fn(BODY_POSE, BODY_POSE, |i, j| covariance[[i, j]]);
            let factor = Cholesky::new(matrix).ok_or_else(|| {
                Error::argument(
                    "pose prior: a covariance is not positive definite: fit with a greater \
                     regularisation",
                )
            })?;
            let volume: f64 = factor.l_dirty().diagonal().iter().map(|x| x.ln()).sum();
            let mean = DVector::from_iterator(BODY_POSE, mean.iter().copied());
            components.push(Component { mean, factor, offset: volume - weight.ln() });
        }
        let least = components.iter().map(|c| c.offset).fold(f64::INFINITY, f64::min);
        for component in &mut components {
            component.offset -= least;
        }
        Ok(Self { components, weights, means, covariances })
    }

    /// Fits a mixture of `components` Gaussians to poses in axis-angle, radians, `[n, 72]`, or `[n,
    /// 69]` without the global orientation.
    ///
    /// # Errors
    /// If there is no pose, or poses are not finite or have another size.
    pub fn fit(
        poses: ArrayView2<'_, f64>,
        components: usize,
        options: &MixtureOptions,
    ) -> Result<Self> {
        let body = match poses.ncols() {
            BODY_POSE => poses,
            72 => poses.slice_move(s![.., 3..]),
            other => {
                return Err(Error::argument(format!(
                    "pose prior: poses of {other} numbers, expected 72 or {BODY_POSE}"
                )));
            }
        };
        let mixture = Mixture::fit(body, components, options)?;
        Self::new(mixture.weights(), mixture.means(), mixture.covariances())
    }

    /// The default prior: fitted to [`synthetic_poses`].
    ///
    /// # Errors
    /// If the mixture does not converge.
    pub fn synthetic() -> Result<Self> {
        Self::fit(synthetic_poses().view(), COMPONENTS, &OPTIONS)
    }

    /// Number of Gaussians.
    pub fn components(&self) -> usize {
        self.components.len()
    }

    /// Energy `E_θ` of a body pose `[69]`, radians; `scale` times its gradient is added to `gradient`
    /// `[69]`.
    pub fn energy(&self, pose: &[f64], scale: f64, gradient: &mut [f64]) -> f64 {
        let pose = DVector::from_column_slice(pose);
        let energies = self.components.iter().map(|component| {
            let mut from = &pose - &component.mean;
            component.factor.l_dirty().solve_lower_triangular_mut(&mut from);
            (component.offset + 0.5 * from.norm_squared(), component)
        });
        let Some((energy, nearest)) = energies.min_by(|a, b| a.0.total_cmp(&b.0)) else {
            return 0.0;
        };
        let pull = nearest.factor.solve(&(pose - &nearest.mean));
        gradient.iter_mut().zip(pull.iter()).for_each(|(g, p)| *g += scale * p);
        energy
    }

    /// Weights of the Gaussians, `[components]`.
    pub fn weights(&self) -> &Array1<f64> {
        &self.weights
    }

    /// Means of the Gaussians, radians, `[components, 69]`.
    pub fn means(&self) -> &Array2<f64> {
        &self.means
    }

    /// Reads the pickle of SMPLify (`.pkl` with `means`, `covars`, `weights`), a pickled mixture of
    /// scikit-learn, or an `.npz` archive that [`save`](Self::save) wrote. No code in a pickle is
    /// executed.
    ///
    /// # Errors
    /// If an array is missing or malformed; the error has the file and the array.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let is_npz = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npz"));
        let [weights, means, covariances] = if is_npz {
            let mut file = Npz::open(path)?;
            [file.f64("weights")?, file.f64("means")?, file.f64("covariances")?]
        } else {
            let pickle = Pickle::open(path)?;
            let root = pickle.root();
            [
                entry(&root, &["weights", "weights_"])?,
                entry(&root, &["means", "means_"])?,
                entry(&root, &["covars", "covars_", "covariances", "covariances_"])?,
            ]
        };
        let weights = weights.into_shape_with_order(weights_len(&means));
        let weights = weights.map_err(|error| Error::field(path, "weights", error.to_string()))?;
        Self::new(weights, shaped(path, "means", means)?, shaped(path, "covariances", covariances)?)
            .map_err(|error| Error::format(path, error.to_string()))
    }

    /// Writes an `.npz` archive of `weights`, `means` and `covariances`.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let mut file = NpzWriter::create(path)?;
        file.add("weights", &self.weights)?;
        file.add("means", &self.means)?;
        file.add("covariances", &self.covariances)?;
        Ok(file.finish()?)
    }
}

/// Number of weights: as many as means. They may be stored as a row or a column.
fn weights_len(means: &ArrayD<f64>) -> usize {
    means.shape().first().copied().unwrap_or(0)
}

fn entry(root: &Value<'_>, names: &[&str]) -> Result<ArrayD<f64>> {
    let value = match names.iter().find_map(|name| root.get(name)) {
        Some(value) => value,
        None => root.require(names[0])?,
    };
    Ok(value.array()?)
}

fn shaped<D: Dimension>(
    path: &Path,
    field: &str,
    array: ArrayD<f64>,
) -> Result<ndarray::Array<f64, D>> {
    array.into_dimensionality().map_err(|error| Error::field(path, field, error.to_string()))
}

/// Poses of the synthetic training motions in several styles, radians, `[n, 72]`.
pub fn synthetic_poses() -> Array2<f64> {
    let mut rows = Vec::new();
    for motion in Motion::CAPTURED.into_iter().filter(|motion| !motion.is_test()) {
        for style in 0..STYLES {
            let mut rng = ChaCha8Rng::seed_from_u64(motion as u64);
            rng.set_stream(style);
            let style = MotionStyle::random(&mut rng);
            rows.extend((0..INSTANTS).map(|at| motion.pose(&style, 0.37 * f64::from(at))));
        }
    }
    Array2::from(rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::assert_gradient;

    /// Two components in mirrored places, of different weight and size.
    fn small() -> PosePrior {
        let means = Array2::from_shape_fn((2, BODY_POSE), |(k, i)| {
            if k == 0 { 0.01 * i as f64 } else { -0.02 * (i % 5) as f64 }
        });
        let covariances = Array3::from_shape_fn((2, BODY_POSE, BODY_POSE), |(k, i, j)| {
            let own = if i == j { 0.05 + 0.1 * k as f64 } else { 0.0 };
            own + 0.01 * ((i + 1) as f64 * 0.3).sin() * ((j + 1) as f64 * 0.3).sin()
        });
        PosePrior::new(Array1::from(vec![0.25, 0.75]), means, covariances).unwrap()
    }

    #[test]
    fn the_energy_is_the_formulas() {
        let prior = small();
        let energy = |pose: &[f64]| prior.energy(pose, 0.0, &mut [0.0; BODY_POSE]);
        // With a full inverse and determinant, up to a constant.
        let direct = |pose: &[f64]| {
            (0..2)
                .map(|k| {
                    let covariance =
                        DMatrix::from_fn(BODY_POSE, BODY_POSE, |i, j| prior.covariances[[k, i, j]]);
                    let from = DVector::from_fn(BODY_POSE, |i, _| pose[i] - prior.means[[k, i]]);
                    let inverse = covariance.clone().try_inverse().unwrap();
                    let square = (from.transpose() * inverse * &from)[(0, 0)];
                    0.5 * (square + covariance.determinant().ln()) - prior.weights[k].ln()
                })
                .fold(f64::INFINITY, f64::min)
        };
        let poses = [0.0, 0.05, 0.3, -0.4].map(|x| [x; BODY_POSE]);
        let constant = direct(&poses[0]) - energy(&poses[0]);
        for pose in &poses {
            assert!((direct(pose) - energy(pose) - constant).abs() < 1e-8);
            let mut gradient = vec![0.0; BODY_POSE];
            prior.energy(pose, 1.0, &mut gradient);
            assert_gradient(pose, &gradient, 1e-7, energy);
        }
        let means = [0, 1].map(|k| energy(&prior.means.row(k).to_vec()));
        assert!(means[0].min(means[1]) == 0.0 && means[0].max(means[1]) > 0.0);
    }

    #[test]
    fn the_default_prefers_motions_to_contortions() {
        let prior = PosePrior::synthetic().unwrap();
        assert_eq!(prior.components(), COMPONENTS);
        let energy = |pose: &[f64]| prior.energy(pose, 0.0, &mut [0.0; BODY_POSE]);
        let mut rng = ChaCha8Rng::seed_from_u64(99);
        let mut energies: Vec<f64> = (0..100)
            .map(|i| {
                let style = MotionStyle::random(&mut rng);
                energy(&Motion::CAPTURED[i % 15].pose(&style, 0.1 * i as f64)[3..])
            })
            .collect();
        energies.sort_by(f64::total_cmp);
        let median = energies[50];
        let typical = prior.means().row(0).to_vec();
        let mut contorted = typical.clone();
        contorted[3 * 3] = -2.0; // left knee bent forwards
        assert!(energy(&contorted) > 3.0 * median, "{median} {}", energy(&contorted));
        assert!(energy(&typical) < median);
    }

    #[test]
    fn files_come_back_and_wrong_ones_are_named() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("prior.npz");
        let prior = small();
        prior.save(&path).unwrap();
        let back = PosePrior::load(&path).unwrap();
        assert_eq!(back.means, prior.means);
        assert_eq!(back.covariances, prior.covariances);

        let path = directory.path().join("prior.pkl");
        std::fs::write(&path, pickled(&prior)).unwrap();
        let back = PosePrior::load(&path).unwrap();
        assert_eq!(back.weights, prior.weights);
        assert_eq!(back.covariances, prior.covariances);

        std::fs::write(&path, b"(dp0\n.").unwrap();
        let message = PosePrior::load(&path).unwrap_err().to_string();
        assert!(message.contains("prior.pkl") && message.contains("weights"), "{message}");
        assert!(PosePrior::fit(Array2::zeros((3, 5)).view(), 1, &OPTIONS).is_err());
        let short = (Array1::ones(1), Array2::zeros((1, 5)), Array3::zeros((1, 5, 5)));
        assert!(PosePrior::new(short.0, short.1, short.2).is_err());
    }

    /// A dictionary of (nested) lists in the text protocol, with SMPLify's keys.
    fn pickled(prior: &PosePrior) -> Vec<u8> {
        fn list(values: impl Iterator<Item = String>) -> String {
            let items: Vec<String> = values.map(|value| value + "a").collect();
            format!("(l{}", items.concat())
        }
        let number = |x: &f64| format!("F{x:?}\n");
        let means = list(prior.means.rows().into_iter().map(|row| list(row.iter().map(number))));
        let covariances =
            list(prior.covariances.outer_iter().map(|matrix| {
                list(matrix.rows().into_iter().map(|row| list(row.iter().map(number))))
            }));
        let weights = list(prior.weights.iter().map(number));
        format!("(dS'means'\n{means}sS'covars'\n{covariances}sS'weights'\n{weights}s.").into_bytes()
    }
}
