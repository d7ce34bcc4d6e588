use std::path::Path;

use cape_core::npy::{Npz, NpzWriter};
use ndarray::{Array1, Array2, ArrayView2, Axis};

use super::Network;
use crate::{Error, Result, error::finite};

/// Means and standard deviations of columns.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Scale {
    mean: Array1<f64>,
    deviation: Array1<f64>,
}

impl Scale {
    /// Of rows `[n, numbers]`; a column that never changes has deviation 1.
    pub(super) fn of(rows: ArrayView2<'_, f64>) -> Self {
        let count = rows.nrows().max(1) as f64;
        let mean = rows.sum_axis(Axis(0)) / count;
        let off = &rows - &mean;
        let deviation = off.map_axis(Axis(0), |column| (column.dot(&column) / count).sqrt());
        let floor = |(&d, &m): (&f64, &f64)| if d > 1e-12 * m.abs().max(1.0) { d } else { 1.0 };
        let deviation = deviation.iter().zip(&mean).map(floor).collect();
        Self { mean, deviation }
    }

    pub(super) fn apply(&self, rows: ArrayView2<'_, f64>) -> Array2<f64> {
        (&rows - &self.mean) / &self.deviation
    }

    fn undo(&self, rows: &Array2<f64>) -> Array2<f64> {
        rows * &self.deviation + &self.mean
    }
}

/// A trained network between standardised inputs and targets.
#[derive(Debug, Clone, PartialEq)]
pub struct Regressor {
    inputs: Scale,
    network: Network,
    targets: Scale,
}

impl Regressor {
    pub(super) fn new(inputs: Scale, network: Network, targets: Scale) -> Result<Self> {
        let sizes = network.sizes();
        let ends = (sizes.first().copied(), sizes.last().copied());
        if ends != (Some(inputs.mean.len()), Some(targets.mean.len()))
            || inputs.mean.len() != inputs.deviation.len()
            || targets.mean.len() != targets.deviation.len()
        {
            return Err(Error::argument(format!(
                "a network of sizes {sizes:?} between {} inputs and {} targets",
                inputs.mean.len(),
                targets.mean.len()
            )));
        }
        Ok(Self { inputs, network, targets })
    }

    /// The network.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// Targets `[n, outputs]` of inputs `[n, inputs]`, both in their own units. Frames do not
    /// depend on each other: an animation can be predicted frame by frame as it arrives.
    pub fn predict(&self, inputs: ArrayView2<'_, f64>) -> Result<Array2<f64>> {
        if inputs.ncols() != self.inputs.mean.len() {
            return Err(Error::argument(format!(
                "{} inputs, but the regressor was trained with {}",
                inputs.ncols(),
                self.inputs.mean.len()
            )));
        }
        finite("inputs", inputs)?;
        Ok(self.targets.undo(&self.network.forward(self.inputs.apply(inputs).view())?))
    }

    /// Writes everything as one `.npz`, atomically.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let mut file = NpzWriter::create(path)?;
        self.write(&mut file)?;
        Ok(file.finish()?)
    }

    /// Adds everything to an archive.
    pub(crate) fn write(&self, file: &mut NpzWriter) -> Result<()> {
        let sizes: Array1<i64> = self.network.sizes().iter().map(|&n| n as i64).collect();
        file.add("sizes", &sizes)?;
        file.add("parameters", self.network.parameters())?;
        file.add("input_mean", &self.inputs.mean)?;
        file.add("input_deviation", &self.inputs.deviation)?;
        file.add("target_mean", &self.targets.mean)?;
        file.add("target_deviation", &self.targets.deviation)?;
        Ok(())
    }

    /// Reads what [`save`](Self::save) wrote.
    ///
    /// # Errors
    /// If an array is missing, does not fit the others, or is not finite; it is named.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        Self::read(&mut Npz::open(path)?)
    }

    /// Reads what [`write`](Self::write) added.
    pub(crate) fn read(file: &mut Npz) -> Result<Self> {
        let path = file.path().to_owned();
        let fault = |field: &str, message: String| cape_core::Error::field(&path, field, message);
        let sizes: Vec<usize> = file
            .i64("sizes")?
            .iter()
            .map(|&n| usize::try_from(n).map_err(|error| fault("sizes", error.to_string())))
            .collect::<Result<_, _>>()?;
        let mut vector = |name: &str| -> Result<Array1<f64>> {
            let array = file.f64(name)?;
            file.expect_shape(name, array.shape(), &[None])?;
            finite(name, &array)?;
            Ok(Array1::from_iter(array))
        };
        let network = Network::new(&sizes, vector("parameters")?)?;
        let mut scale = |mean: &str, deviation: &str| -> Result<Scale> {
            Ok(Scale { mean: vector(mean)?, deviation: vector(deviation)? })
        };
        let inputs = scale("input_mean", "input_deviation")?;
        let targets = scale("target_mean", "target_deviation")?;
        Self::new(inputs, network, targets)
    }
}
