use std::path::Path;

use cape_core::npy::{Npz, NpzWriter};
use ndarray::{Array1, Array2, ArrayView2, Axis};

use super::Network;
use crate::{Error, Result};
use cape_core::expect_finite;

/// Standardised inputs are clamped to this many standard deviations.
const FURTHEST: f64 = 3.0;

/// Mean and standard deviation of each column.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Standardiser {
    mean: Array1<f64>,
    deviation: Array1<f64>,
}

impl Standardiser {
    /// Statistics of rows `[n, numbers]`, with a least deviation for each column, `[numbers]`; a constant
    /// column without one gets deviation 1.
    pub(super) fn from_rows(rows: ArrayView2<'_, f64>, floors: &[f64]) -> Self {
        let (mean, deviation) = statistics(rows);
        let scale = |((&d, &m), &floor): ((&f64, &f64), &f64)| {
            if d.max(floor) > 1e-12 * m.abs().max(1.0) { d.max(floor) } else { 1.0 }
        };
        let deviation = deviation.iter().zip(&mean).zip(floors).map(scale).collect();
        Self { mean, deviation }
    }

    /// Statistics with one deviation for all columns: the root of their mean variance, so that a
    /// difference counts the same in each.
    pub(super) fn common(rows: ArrayView2<'_, f64>) -> Self {
        let (mean, deviation) = statistics(rows);
        let variance = deviation.dot(&deviation) / deviation.len().max(1) as f64;
        let scale = if variance > 0.0 { variance.sqrt() } else { 1.0 };
        Self { deviation: Array1::from_elem(mean.len(), scale), mean }
    }

    pub(super) fn apply(&self, rows: ArrayView2<'_, f64>) -> Array2<f64> {
        (&rows - &self.mean) / &self.deviation
    }

    /// [`apply`](Self::apply), clamped to [`FURTHEST`] standard deviations: a joint that hardly
    /// moved in training must not dominate the prediction when it moves later.
    pub(super) fn bounded(&self, rows: ArrayView2<'_, f64>) -> Array2<f64> {
        self.apply(rows).mapv_into(|x| x.clamp(-FURTHEST, FURTHEST))
    }

    /// Differences of standardised numbers `[n, numbers]` in the numbers' own units.
    pub(super) fn scaled(&self, differences: &Array2<f64>) -> Array2<f64> {
        differences * &self.deviation
    }

    pub(super) fn mean(&self) -> &Array1<f64> {
        &self.mean
    }

    /// Adds `<name>_mean` and `<name>_deviation` to an archive.
    pub(super) fn write(&self, file: &mut NpzWriter, name: &str) -> Result<()> {
        file.add(&format!("{name}_mean"), &self.mean)?;
        file.add(&format!("{name}_deviation"), &self.deviation)?;
        Ok(())
    }

    /// Reads the arrays that [`write`](Self::write) added.
    pub(super) fn read(file: &mut Npz, name: &str) -> Result<Self> {
        let mean = vector(file, &format!("{name}_mean"))?;
        let deviation = vector(file, &format!("{name}_deviation"))?;
        file.expect_shape(&format!("{name}_deviation"), deviation.shape(), &[Some(mean.len())])?;
        Ok(Self { mean, deviation })
    }

    fn undo(&self, rows: &Array2<f64>) -> Array2<f64> {
        self.scaled(rows) + &self.mean
    }
}

/// A trained network with standardised inputs and targets.
#[derive(Debug, Clone, PartialEq)]
pub struct Regressor {
    inputs: Standardiser,
    network: Network,
    targets: Standardiser,
}

impl Regressor {
    pub(super) fn new(
        inputs: Standardiser,
        network: Network,
        targets: Standardiser,
    ) -> Result<Self> {
        let sizes = network.sizes();
        let ends = (sizes.first().copied(), sizes.last().copied());
        if ends != (Some(inputs.mean.len()), Some(targets.mean.len()))
            || inputs.mean.len() != inputs.deviation.len()
            || targets.mean.len() != targets.deviation.len()
        {
            return Err(Error::argument(format!(
                "regressor: network sizes {sizes:?}, expected {} inputs and {} outputs",
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

    /// Targets `[n, outputs]` of inputs `[n, inputs]`, both in their own units. Inputs are clamped
    /// to three standard deviations of the training set. Rows are independent: frames can be
    /// predicted one at a time.
    ///
    /// # Errors
    /// If inputs are not finite or have another number of columns.
    pub fn predict(&self, inputs: ArrayView2<'_, f64>) -> Result<Array2<f64>> {
        if inputs.ncols() != self.inputs.mean.len() {
            return Err(Error::argument(format!(
                "regressor: {} inputs, expected {}",
                inputs.ncols(),
                self.inputs.mean.len()
            )));
        }
        expect_finite("inputs", inputs)?;
        Ok(self.targets.undo(&self.network.forward(self.inputs.bounded(inputs).view())?))
    }

    /// Inputs as the network has them, `[n, inputs]`.
    pub(crate) fn scaled_inputs(&self, inputs: ArrayView2<'_, f64>) -> Array2<f64> {
        self.inputs.bounded(inputs)
    }

    /// Writes the regressor as one `.npz` archive, atomically.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let mut file = NpzWriter::create(path)?;
        self.write(&mut file)?;
        Ok(file.finish()?)
    }

    /// Adds the arrays to an archive.
    pub(crate) fn write(&self, file: &mut NpzWriter) -> Result<()> {
        let sizes: Array1<i64> = self.network.sizes().iter().map(|&n| n as i64).collect();
        file.add("sizes", &sizes)?;
        file.add("parameters", self.network.parameters())?;
        self.inputs.write(file, "input")?;
        self.targets.write(file, "target")
    }

    /// Reads a regressor that [`save`](Self::save) wrote.
    ///
    /// # Errors
    /// If an array is missing, not finite, or inconsistent with the others; the error has its name.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        Self::read(&mut Npz::open(path)?)
    }

    /// Reads the arrays that [`write`](Self::write) added.
    pub(crate) fn read(file: &mut Npz) -> Result<Self> {
        let path = file.path().to_owned();
        let fault = |field: &str, message: String| cape_core::Error::field(&path, field, message);
        let sizes: Vec<usize> = file
            .i64("sizes")?
            .iter()
            .map(|&n| usize::try_from(n).map_err(|error| fault("sizes", error.to_string())))
            .collect::<Result<_, _>>()?;
        let network = Network::new(&sizes, vector(file, "parameters")?)?;
        let (inputs, targets) =
            (Standardiser::read(file, "input")?, Standardiser::read(file, "target")?);
        Self::new(inputs, network, targets)
    }
}

/// Mean and standard deviation of each column.
fn statistics(rows: ArrayView2<'_, f64>) -> (Array1<f64>, Array1<f64>) {
    let count = rows.nrows().max(1) as f64;
    let mean = rows.sum_axis(Axis(0)) / count;
    let off = &rows - &mean;
    let deviation = off.map_axis(Axis(0), |column| (column.dot(&column) / count).sqrt());
    (mean, deviation)
}

fn vector(file: &mut Npz, name: &str) -> Result<Array1<f64>> {
    let array = file.f64(name)?;
    file.expect_shape(name, array.shape(), &[None])?;
    expect_finite(name, &array)?;
    Ok(Array1::from_iter(array))
}
