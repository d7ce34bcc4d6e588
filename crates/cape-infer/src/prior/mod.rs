//! Densities of latent codes, fitted after training (Ghosh et al. 2020, as in CAPE §6.2).
//!
//! The aggregate posterior of a trained encoder differs from the standard normal prior, and the
//! decoder reconstructs best under the aggregate posterior. Samples are therefore drawn from a
//! density fitted to the posterior means of training frames: a [`Mixture`] of normal distributions or a [`KernelDensity`], for all outfits
//! together or for each by itself.

mod codes;

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use cape_core::{
    Outfit,
    npy::{Npz, NpzWriter},
};
use ndarray::{Array0, Array1, Array2, Array3, ArrayD, Axis, Dimension, concatenate};
use rand::{SeedableRng, rngs::ChaCha8Rng};
use rand_distr::{Distribution, StandardNormal};

pub use codes::LatentCodes;

use cape_stats::density::{
    GaussianMoments, GaussianTransport, KernelDensity, Mixture, MixtureOptions,
};

use crate::{Error, Result, Run};
use cape_core::ProgressFn;
use cape_data::PackedSet;

/// The name of the group of all outfits in files.
const JOINT: &str = "all";

const STEP: &str = "step";

/// Kind of density to fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DensityKind {
    /// A Gaussian mixture with this number of components.
    Mixture(usize),
    /// A Gaussian mixture with up to this number of components, chosen by the Bayesian information
    /// criterion.
    MixtureUpTo(usize),
    /// A kernel density estimate.
    Kernel,
}

/// Options of fitting a prior to a run's codes. The default is a mixture for each outfit, of up to 12
/// components by the Bayesian information criterion.
///
/// ```
/// use cape_infer::prior::{DensityKind, PriorOptions};
///
/// // The authors' mixture: ten components for all outfits together.
/// let options = PriorOptions {
///     kind: DensityKind::Mixture(10),
///     by_outfit: false,
///     ..PriorOptions::default()
/// };
/// assert_eq!(options.frames, 4096);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PriorOptions {
    /// Kind of density.
    pub kind: DensityKind,
    /// Fit one density for each outfit instead of one for all together.
    pub by_outfit: bool,
    /// Largest number of training frames to encode, evenly spaced.
    pub frames: usize,
    /// Seed of the initialisations.
    pub seed: u64,
}

impl Default for PriorOptions {
    fn default() -> Self {
        Self { kind: DensityKind::MixtureUpTo(12), by_outfit: true, frames: 4096, seed: 1 }
    }
}

/// A density of latent codes.
#[derive(Debug, Clone)]
pub enum Density {
    /// A Gaussian mixture.
    Mixture(Mixture),
    /// A kernel density estimate.
    Kernel(KernelDensity),
}

/// A density for all outfits together, or one for each.
///
/// ```
/// use cape_core::Outfit;
/// use cape_infer::prior::{LatentCodes, Density, DensityKind, Prior};
/// use cape_stats::density::MixtureOptions;
///
/// // Codes that lie about (3, 0) for one outfit, and about (−3, 0) for another.
/// let code = |x: f64, i: i32| vec![x + 0.1 * f64::from(i % 3), 0.1 * f64::from(i % 5)];
/// let rows = (0..30).flat_map(|i| {
///     [(Outfit::LONG_LONG, code(3.0, i)), (Outfit::SHORT_SHORT, code(-3.0, i))]
/// });
/// let codes = LatentCodes::new(2, rows.collect())?;
/// let prior = Prior::fit(&codes, DensityKind::Mixture(1), true, &MixtureOptions::default())?;
/// assert!(prior.groups().all(|(_, density)| matches!(density, Density::Mixture(_))));
/// let drawn = prior.sample(Outfit::LONG_LONG, 10, 1.0, 7);
/// assert_eq!(drawn.dim(), (10, 2));
/// assert!(drawn.column(0).iter().all(|x| (2.0..4.0).contains(x)));
///
/// let directory = tempfile::tempdir()?;
/// prior.save(directory.path().join("prior.npz"))?;
/// let loaded = Prior::load(directory.path().join("prior.npz"))?;
/// assert_eq!(loaded.sample(Outfit::LONG_LONG, 10, 1.0, 7), drawn);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Prior {
    latent: usize,
    /// `None`: outfits that have none of their own.
    groups: BTreeMap<Option<Outfit>, Density>,
    step: Option<u64>,
}

impl Density {
    fn fit(points: &Array2<f64>, kind: DensityKind, options: &MixtureOptions) -> Result<Self> {
        let points = points.view();
        Ok(match kind {
            DensityKind::Mixture(count) => Self::Mixture(Mixture::fit(points, count, options)?),
            DensityKind::MixtureUpTo(most) => {
                Self::Mixture(Mixture::fit_by_bic(points, most, options)?)
            }
            DensityKind::Kernel => Self::Kernel(KernelDensity::fit(points)?),
        })
    }

    /// Codes `[n, latent]`.
    pub fn sample(&self, n: usize, temperature: f64, rng: &mut ChaCha8Rng) -> Array2<f64> {
        match self {
            Self::Mixture(mixture) => mixture.sample(n, temperature, rng),
            Self::Kernel(density) => density.sample(n, temperature, rng),
        }
    }

    /// Mean and covariance.
    pub fn moments(&self) -> GaussianMoments {
        match self {
            Self::Mixture(mixture) => mixture.moments(),
            Self::Kernel(density) => density.moments(),
        }
    }

    fn dimensions(&self) -> usize {
        match self {
            Self::Mixture(mixture) => mixture.dimensions(),
            Self::Kernel(density) => density.points().ncols(),
        }
    }
}

impl Prior {
    /// Fits to the codes of training frames of `set`.
    pub fn of_run(
        run: &Run,
        set: &PackedSet,
        options: &PriorOptions,
        progress: &mut ProgressFn,
    ) -> Result<Self> {
        let codes = LatentCodes::from_set(run, set, options.frames, progress)?;
        let mixture = MixtureOptions { seed: options.seed, ..MixtureOptions::default() };
        Self::fit(&codes, options.kind, options.by_outfit, &mixture)
    }

    /// Fits to codes, by outfit or to all together.
    pub fn fit(
        codes: &LatentCodes,
        kind: DensityKind,
        by_outfit: bool,
        options: &MixtureOptions,
    ) -> Result<Self> {
        let mut groups = BTreeMap::new();
        if by_outfit {
            for outfit in codes.outfits() {
                let points = codes.for_outfit(Some(outfit));
                groups.insert(Some(outfit), Density::fit(&points, kind, options)?);
            }
        } else {
            groups.insert(None, Density::fit(&codes.for_outfit(None), kind, options)?);
        }
        Ok(Self { latent: codes.latent(), groups, step: codes.step() })
    }

    /// Numbers of a code.
    pub fn latent(&self) -> usize {
        self.latent
    }

    /// Steps of training of the checkpoint that it suits, if it is known.
    pub fn step(&self) -> Option<u64> {
        self.step
    }

    /// The densities, with the outfit that each is for, if for one.
    pub fn groups(&self) -> impl Iterator<Item = (Option<Outfit>, &Density)> {
        self.groups.iter().map(|(&outfit, density)| (outfit, density))
    }

    /// Codes for an outfit, `[n, latent]`; deviations from the component means are
    /// multiplied by `temperature`. An outfit without a density is drawn from the standard normal.
    pub fn sample(&self, outfit: Outfit, n: usize, temperature: f64, seed: u64) -> Array2<f32> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(outfit.stream());
        match self.groups.get(&Some(outfit)).or_else(|| self.groups.get(&None)) {
            Some(density) => density.sample(n, temperature, &mut rng).mapv(|x| x as f32),
            None => Array2::from_shape_simple_fn((n, self.latent), || {
                let x: f64 = StandardNormal.sample(&mut rng);
                (x * temperature) as f32
            }),
        }
    }

    /// Map from the codes of one outfit to those of another: optimal transport between the normal
    /// distributions of their densities' moments. `None` if they have the same density, or one has none of
    /// its own.
    ///
    /// A decoder knows each outfit's codes where the encoder puts them. A code that is decoded as it is under
    /// another outfit keeps traces of its own, such as a long leg on a bare calf.
    ///
    /// # Errors
    /// If the densities have different dimensions.
    pub fn transport(&self, from: Outfit, to: Outfit) -> Result<Option<GaussianTransport>> {
        let densities = [from, to].map(|outfit| self.groups.get(&Some(outfit)));
        let [Some(source), Some(target)] = densities else { return Ok(None) };
        if from == to {
            return Ok(None);
        }
        Ok(Some(GaussianTransport::between(&source.moments(), &target.moments())?))
    }

    /// Codes `[n, latent]` of an outfit, taken to another by [`transport`](Self::transport).
    ///
    /// # Errors
    /// If codes do not have as many numbers as the density.
    pub fn transport_codes(
        &self,
        codes: &Array2<f32>,
        from: Outfit,
        to: Outfit,
    ) -> Result<Array2<f32>> {
        if codes.ncols() != self.latent {
            return Err(Error::argument(format!(
                "codes of {} numbers, expected {}",
                codes.ncols(),
                self.latent
            )));
        }
        Ok(match self.transport(from, to)? {
            Some(map) => map.apply(codes.mapv(f64::from).view()).mapv(|x| x as f32),
            None => codes.clone(),
        })
    }

    /// One code for each of `outfits`, `[outfits, latent]`.
    ///
    /// # Errors
    /// If there are no outfits.
    pub fn sample_each(
        &self,
        outfits: &[Outfit],
        temperature: f64,
        seed: u64,
    ) -> Result<Array2<f32>> {
        let codes: Vec<Array2<f32>> =
            outfits.iter().map(|&outfit| self.sample(outfit, 1, temperature, seed)).collect();
        let views: Vec<_> = codes.iter().map(|codes| codes.view()).collect();
        concatenate(Axis(0), &views).map_err(|error| Error::argument(error.to_string()))
    }

    /// Arrays by name: for `all` or each outfit `NAME.weights`, `NAME.means` and `NAME.covariances`, or
    /// `NAME.points` and `NAME.bandwidth`; and `step`, if it is known.
    pub fn arrays(&self) -> BTreeMap<String, ArrayD<f64>> {
        let mut arrays = BTreeMap::new();
        for (outfit, density) in &self.groups {
            let name = outfit.as_ref().map_or(JOINT, Outfit::name);
            let mut add = |array: &str, values: ArrayD<f64>| {
                arrays.insert(format!("{name}.{array}"), values);
            };
            match density {
                Density::Mixture(mixture) => {
                    add("weights", mixture.weights().into_dyn());
                    add("means", mixture.means().into_dyn());
                    add("covariances", mixture.covariances().into_dyn());
                }
                Density::Kernel(density) => {
                    add("points", density.points().clone().into_dyn());
                    add("bandwidth", Array0::from_elem((), density.bandwidth()).into_dyn());
                }
            }
        }
        if let Some(step) = self.step {
            arrays.insert(STEP.to_owned(), Array0::from_elem((), step as f64).into_dyn());
        }
        arrays
    }

    /// Writes an `.npz` of the [`arrays`](Self::arrays).
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let mut file = NpzWriter::create(path)?;
        for (name, array) in self.arrays() {
            match name.as_str() {
                STEP => file.add(STEP, &array.mapv(|step| step as i64))?,
                _ => file.add(&name, &array)?,
            }
        }
        Ok(file.finish()?)
    }

    /// Reads what [`save`](Self::save) wrote.
    ///
    /// # Errors
    /// If an array is missing or invalid; the error names the file.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let mut file = Npz::open(path)?;
        let mut arrays = BTreeMap::new();
        for name in file.names() {
            let array = match name.as_str() {
                STEP => file.i64(STEP)?.mapv(|step| step as f64),
                name if name.contains('.') => file.f64(name)?,
                _ => continue,
            };
            arrays.insert(name, array);
        }
        Self::from_arrays(path, arrays)
    }

    /// Density of the [`arrays`](Self::arrays) in a file; errors name it by `path`.
    ///
    /// # Errors
    /// If an array is missing or invalid.
    pub fn from_arrays(path: &Path, mut arrays: BTreeMap<String, ArrayD<f64>>) -> Result<Self> {
        let mut groups = BTreeMap::new();
        for outfit in groups_of(path, arrays.keys())? {
            let name = outfit.as_ref().map_or(JOINT, Outfit::name);
            let density = if arrays.contains_key(&format!("{name}.weights")) {
                let weights: Array1<f64> = take(path, &mut arrays, &format!("{name}.weights"))?;
                let means: Array2<f64> = take(path, &mut arrays, &format!("{name}.means"))?;
                let covariances: Array3<f64> =
                    take(path, &mut arrays, &format!("{name}.covariances"))?;
                Mixture::new(&weights, &means, &covariances).map(Density::Mixture)
            } else {
                let points: Array2<f64> = take(path, &mut arrays, &format!("{name}.points"))?;
                let bandwidth: Array0<f64> = take(path, &mut arrays, &format!("{name}.bandwidth"))?;
                KernelDensity::new(points, bandwidth.into_scalar()).map(Density::Kernel)
            };
            let density =
                density.map_err(|error| Error::format(path, format!("{name}: {error}")))?;
            groups.insert(outfit, density);
        }
        let mut sizes = groups.values().map(Density::dimensions);
        let Some(latent) = sizes.next() else {
            let message = format!("holds no density: expected `{JOINT}` or an outfit");
            return Err(Error::format(path, message));
        };
        if let Some(other) = sizes.find(|&other| other != latent) {
            return Err(Error::format(path, format!("codes of {latent} and of {other} numbers")));
        }
        let step = arrays.get(STEP).and_then(|step| step.first()).filter(|step| **step >= 0.0);
        let step = step.map(|&step| step as u64);
        Ok(Self { latent, groups, step })
    }
}

/// Groups of a file, by the names of their arrays.
fn groups_of<'a>(
    path: &Path,
    names: impl Iterator<Item = &'a String>,
) -> Result<BTreeSet<Option<Outfit>>> {
    let names = names.filter_map(|name| name.rsplit_once('.'));
    let names = names.filter(|(_, array)| matches!(*array, "weights" | "points"));
    names
        .map(|(name, _)| match name {
            JOINT => Ok(None),
            name => name.parse().map(Some).map_err(|error: cape_core::Error| {
                Error::format(path, format!("`{name}`: {error}"))
            }),
        })
        .collect()
}

fn take<D: Dimension>(
    path: &Path,
    arrays: &mut BTreeMap<String, ArrayD<f64>>,
    name: &str,
) -> Result<ndarray::Array<f64, D>> {
    let array = arrays.remove(name).ok_or_else(|| Error::field(path, name, "missing"))?;
    let shape = array.shape().to_vec();
    array.into_dimensionality().map_err(|_| {
        let expected = D::NDIM.unwrap_or_default();
        let message = format!("`{name}` has shape {shape:?}, expected {expected} axes");
        Error::format(path, message)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two outfits whose codes are around −3 and 3.
    fn codes() -> LatentCodes {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let rows = (0..400).map(|i| {
            let (outfit, at) =
                if i % 2 == 0 { (Outfit::LONG_LONG, 3.0) } else { (Outfit::SHORT_SHORT, -3.0) };
            let code = (0..2).map(|_| {
                let x: f64 = StandardNormal.sample(&mut rng);
                at + 0.5 * x
            });
            (outfit, code.collect())
        });
        LatentCodes::new(2, rows.collect()).unwrap()
    }

    #[test]
    fn samples_are_where_the_outfits_codes_are() {
        let options = MixtureOptions::default();
        for kind in [DensityKind::Mixture(1), DensityKind::MixtureUpTo(3), DensityKind::Kernel] {
            let prior = Prior::fit(&codes(), kind, true, &options).unwrap();
            let mean =
                |outfit, temperature| prior.sample(outfit, 2000, temperature, 4).mean().unwrap();
            assert!((mean(Outfit::LONG_LONG, 1.0) - 3.0).abs() < 0.1, "{kind:?}");
            assert!((mean(Outfit::SHORT_SHORT, 1.0) + 3.0).abs() < 0.1, "{kind:?}");
            assert!(mean(Outfit::LONG_SHORT, 1.0).abs() < 0.1, "not seen: the standard normal");
            let joint = Prior::fit(&codes(), kind, false, &options).unwrap();
            assert!(joint.sample(Outfit::LONG_LONG, 2000, 1.0, 4).mean().unwrap().abs() < 0.3);
        }
        let one = Prior::fit(&codes(), DensityKind::Mixture(1), true, &options).unwrap();
        let typical = one.sample(Outfit::LONG_LONG, 1, 0.0, 9);
        assert!(typical.iter().all(|x| (x - 3.0).abs() < 0.15));
        assert_eq!(one.sample_each(&Outfit::PAPER, 0.0, 9).unwrap().row(3), typical.row(0));
    }

    #[test]
    fn codes_keep_their_place_among_those_of_another_outfit() {
        let (long, short) = (Outfit::LONG_LONG, Outfit::SHORT_SHORT);
        for kind in [DensityKind::MixtureUpTo(3), DensityKind::Kernel] {
            let prior = Prior::fit(&codes(), kind, true, &MixtureOptions::default()).unwrap();
            let drawn = prior.sample(long, 500, 1.0, 3);
            let moved = prior.transport_codes(&drawn, long, short).unwrap();
            // Both outfits' codes have nearly the same spread, around 3 and −3.
            let shift = (&moved - &drawn).mapv(|x| x + 6.0);
            assert!(shift.iter().all(|x| x.abs() < 0.5), "{kind:?}");
            let back = prior.transport_codes(&moved, short, long).unwrap();
            assert!((&back - &drawn).iter().all(|x| x.abs() < 1e-4), "{kind:?}");
            assert_eq!(prior.transport_codes(&drawn, long, long).unwrap(), drawn);
            // No density of its own.
            let other = prior.transport_codes(&drawn, long, Outfit::SHORT_LONG).unwrap();
            assert_eq!(other, drawn);
            assert!(prior.transport_codes(&Array2::zeros((1, 3)), long, short).is_err());
        }
    }

    #[test]
    fn files_come_back_and_broken_ones_are_named() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("prior.npz");
        for (kind, by_outfit) in [
            (DensityKind::Mixture(2), true),
            (DensityKind::Kernel, true),
            (DensityKind::Kernel, false),
        ] {
            let prior = Prior::fit(&codes(), kind, by_outfit, &MixtureOptions::default()).unwrap();
            prior.save(&path).unwrap();
            let loaded = Prior::load(&path).unwrap();
            let [a, b] = [&prior, &loaded].map(|p| p.sample(Outfit::LONG_LONG, 50, 1.0, 2));
            assert!((&a - &b).iter().all(|x| x.abs() < 1e-5));
        }
        let mut file = NpzWriter::create(&path).unwrap();
        file.add("all.points", &Array1::<f64>::zeros(3)).unwrap();
        file.finish().unwrap();
        let error = Prior::load(&path).unwrap_err().to_string();
        assert!(error.contains("prior.npz") && error.contains("all.points"), "{error}");
        NpzWriter::create(&path).unwrap().finish().unwrap();
        assert!(Prior::load(&path).unwrap_err().to_string().contains("no density"));
    }
}
