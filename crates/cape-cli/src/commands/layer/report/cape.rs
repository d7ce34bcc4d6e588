//! A layer's statistics beside CAPE where both can be had: clothing as displacements of the body.

use std::{path::Path, sync::Arc};

use burn::tensor::Device;
use cape_core::BodyMotion;
use cape_data::{DisplacementStatistics, PackedSet, Split};
use cape_eval::{
    ErrorSamples, EvalOptions, PosteriorUse, reconstruct_test,
    store::{ResultStore, StoreOptions, StoreSettings},
};
use cape_infer::{BodySpec, Run, batches};
use cape_layer::{
    experiment::LearningOptions,
    regress::{FeatureOptions, RegressionInputs},
};
use cape_stats::{errors::mean_distance_mm, pca::PcaOptions};
use ndarray::{Array1, Array2, ArrayView2, Axis, concatenate};
use serde::{Deserialize, Serialize};

use crate::{
    console::Console,
    error::{Error, Result},
};

/// Name of the file of a finished comparison.
const COMPARISON: &str = "comparison.json";
/// Codes drawn for the frames that show how samples differ, and how many frames.
const SAMPLES: usize = 8;
const SAMPLED_FRAMES: usize = 24;

/// A method on the test frames.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct MethodComparison {
    pub(super) method: String,
    /// Numbers of its code.
    pub(super) code: usize,
    pub(super) pose_dependent: bool,
    pub(super) probabilistic: bool,
    /// Error of the frame's own code, millimetres.
    pub(super) reconstruction_mm: f64,
    /// Error of what is expected from pose and outfit alone.
    pub(super) prediction_mm: f64,
    /// Mean distance of samples from their mean; none if there is only one answer.
    pub(super) spread_mm: Option<f64>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct CapeComparison {
    pub(super) frames: usize,
    pub(super) methods: Vec<MethodComparison>,
}

/// The comparison on a run's data, kept in the directory `out`.
pub(super) fn compare(
    root: &Path,
    data: Option<&Path>,
    learning: &LearningOptions,
    (out, overwrite): (&Path, bool),
    device: &Device,
    console: Console,
) -> Result<CapeComparison> {
    let run = Run::open(root, device)?;
    let data = match data {
        Some(data) => data.to_owned(),
        None => run.data()?,
    };
    let settings = StoreSettings::new("layer report, comparison with CAPE", learning)?
        .with_run(&run)?
        .with_packed_set(&data, &[Split::Train, Split::Test])?;
    let options = StoreOptions { overwrite, ..StoreOptions::default() };
    let store = ResultStore::open(out, settings, options)?;
    if let Some(kept) = store.read(COMPARISON)? {
        console.note("comparison with CAPE: already done");
        return Ok(kept);
    }
    store.begin()?;
    let test = Arc::new(run.open_set(&data, Split::Test)?);
    let bench = ComparisonContext { run: &run, data: &data, test: &test, learning, console };
    let mut methods = bench.linear()?;
    methods.push(bench.cape()?);
    let comparison = CapeComparison { frames: test.frames(), methods };
    Ok(store.write(COMPARISON, &comparison)?)
}

struct ComparisonContext<'a> {
    run: &'a Run,
    data: &'a Path,
    test: &'a Arc<PackedSet>,
    learning: &'a LearningOptions,
    console: Console,
}

impl ComparisonContext<'_> {
    fn meter(&self) -> ErrorSamples {
        ErrorSamples::new(self.run.body().vertices(), self.run.clothing())
    }

    /// Mean error over all test frames of displacements `[3 V]`, metres.
    fn error(&self, mut of: impl FnMut(usize) -> Result<Vec<f64>>) -> Result<f64> {
        let mut meter = self.meter();
        for row in 0..self.test.frames() {
            let single =
                |values: Vec<f64>| values.into_iter().map(|x| x as f32).collect::<Vec<_>>();
            let (found, truth) = (single(of(row)?), single(self.test.displacement_row(row)?));
            meter.push(self.test, row, &found, &truth)?;
        }
        Ok(meter.summary().overall.mean)
    }

    /// Principal components of displacements, alone and with a regression from pose and outfit.
    fn linear(&self) -> Result<Vec<MethodComparison>> {
        let train = self.run.open_set(self.data, Split::Train)?;
        let rows = DisplacementStatistics::from_packed(self.data, &mut |_, _| {})?
            .training_rows(train.frames());
        let components = self.learning.components_of(1, rows.len());
        let options = PcaOptions { components, ..PcaOptions::default() };
        let pca = self.console.while_showing("components", "rows", |progress| {
            cape_data::principal_components(self.data, &options, progress)
        })?;
        let encode = |set: &PackedSet, row: usize| -> Result<Array1<f64>> {
            let displacement = Array1::from_vec(set.displacement_row(row)?).insert_axis(Axis(0));
            Ok(pca.encode(displacement.view())?.remove_axis(Axis(0)))
        };
        let decode = |code: Array1<f64>| -> Result<Vec<f64>> {
            Ok(pca.decode(code.insert_axis(Axis(0)).view())?.remove_axis(Axis(0)).to_vec())
        };
        let reconstruction_mm = self.error(|row| decode(encode(self.test, row)?))?;
        // As many numbers as CAPE has.
        let few = self.run.config().model.latent.min(components);
        let few_mm = self.error(|row| {
            let mut code = encode(self.test, row)?;
            code.slice_mut(ndarray::s![few..]).fill(0.0);
            decode(code)
        })?;
        let mean_mm = self.error(|_| Ok(pca.mean.to_vec()))?;

        let frames: Vec<usize> = rows.collect();
        let codes: Vec<Array1<f64>> =
            frames.iter().map(|&row| encode(&train, row)).collect::<Result<_>>()?;
        let codes = Array2::from_shape_fn((codes.len(), components), |(f, k)| codes[f][k]);
        let inputs = inputs(&train, &frames)?;
        let regressor = self.console.while_showing("learn", "iterations", |progress| {
            let most = self.learning.training.minimiser.steps;
            let watch = &mut |epoch: cape_layer::regress::Epoch| progress(epoch.iteration, most);
            self.learning.training.train(&inputs, codes.view(), watch)
        })?;
        let all: Vec<usize> = (0..self.test.frames()).collect();
        let tested = self::inputs(self.test, &all)?.rows;
        let predicted = regressor.regressor.predict(tested.view())?;
        let prediction_mm = self.error(|row| decode(predicted.row(row).to_owned()))?;
        let plain = MethodComparison {
            method: "principal components".into(),
            code: components,
            pose_dependent: false,
            probabilistic: false,
            reconstruction_mm,
            prediction_mm: mean_mm,
            spread_mm: None,
        };
        let layer = MethodComparison {
            method: "layer: components and regression".into(),
            pose_dependent: true,
            prediction_mm,
            ..plain.clone()
        };
        let fewer = MethodComparison { code: few, reconstruction_mm: few_mm, ..plain.clone() };
        Ok(vec![fewer, plain, layer])
    }

    fn cape(&self) -> Result<MethodComparison> {
        let (run, test) = (self.run, self.test);
        let mut meter = self.meter();
        self.console.while_showing("reconstruct", "frames", |progress| {
            let options = EvalOptions { posterior: PosteriorUse::Mean, ..EvalOptions::default() };
            reconstruct_test(run, test, options, progress, &mut |row, predicted, truth| {
                meter.push(test, row, predicted, truth)
            })
        })?;
        let reconstruction_mm = meter.summary().overall.mean;
        let latent = run.config().model.latent;
        let wearers: Vec<BodySpec> = (0..test.frames())
            .map(|row| Ok(cape_infer::registration(test, row)?.1))
            .collect::<Result<_>>()?;
        let mut meter = self.meter();
        self.console.while_showing("predict", "frames", |progress| {
            for rows in batches(wearers.len()) {
                let (chunk, done) = (&wearers[rows.clone()], rows.end);
                let worn =
                    run.decode_displacements(&Array2::zeros((chunk.len(), latent)), chunk)?;
                for (row, worn) in rows.zip(worn.outer_iter()) {
                    let found: Vec<f32> = worn.iter().copied().collect();
                    let truth: Vec<f32> =
                        test.displacement_row(row)?.into_iter().map(|x| x as f32).collect();
                    meter.push(test, row, &found, &truth)?;
                }
                progress(done, wearers.len());
            }
            Ok::<_, Error>(())
        })?;
        let prediction_mm = meter.summary().overall.mean;
        let step = wearers.len().div_ceil(SAMPLED_FRAMES);
        let mut spreads = Vec::new();
        for (seed, wearer) in wearers.iter().step_by(step).enumerate() {
            let codes = run.sample_codes(SAMPLES, seed as u64);
            let worn = run.decode_displacements(&codes, &vec![wearer.clone(); SAMPLES])?;
            let mean = worn.sum_axis(Axis(0)) / SAMPLES as f32;
            for sample in worn.outer_iter() {
                let point = |of: ArrayView2<'_, f32>, v: usize| [0, 1, 2].map(|axis| of[[v, axis]]);
                let pairs =
                    run.clothing().iter().map(|&v| (point(sample, v), point(mean.view(), v)));
                spreads.push(mean_distance_mm(pairs));
            }
        }
        Ok(MethodComparison {
            method: "CAPE".into(),
            code: latent,
            pose_dependent: true,
            probabilistic: true,
            reconstruction_mm,
            prediction_mm,
            spread_mm: Some(spreads.iter().sum::<f64>() / spreads.len().max(1) as f64),
        })
    }
}

/// Joint angles, the direction of gravity, and the outfit of frames; packed frames do not follow
/// each other, so that there are no speeds.
fn inputs(set: &PackedSet, frames: &[usize]) -> Result<RegressionInputs> {
    let shape = |error: ndarray::ShapeError| Error::message(error.to_string());
    let mut poses = Vec::with_capacity(72 * frames.len());
    let width = set.vocabulary().len();
    let mut outfits = Vec::with_capacity(width * frames.len());
    for &frame in frames {
        poses.extend(set.pose(frame)?.into_iter().map(f64::from));
        let label = set.vocabulary().one_hot(set.outfits()[frame])?;
        outfits.extend(label.into_iter().map(f64::from));
    }
    let count = frames.len();
    let poses = Array2::from_shape_vec((count, 72), poses).map_err(shape)?;
    let motion = BodyMotion::new(30.0, poses, Array2::zeros((count, 3)))?;
    let features =
        FeatureOptions { speed: false, angular_speeds: false, ..FeatureOptions::default() };
    let rows = features.rows(&motion);
    let outfits = Array2::from_shape_vec((count, width), outfits).map_err(shape)?;
    let joined = concatenate(Axis(1), &[rows.view(), outfits.view()]).map_err(shape)?;
    let mut inputs = RegressionInputs::new(joined);
    inputs.floors = [features.floors(24), vec![0.0; width]].concat();
    inputs.noisy[rows.ncols()..].fill(true);
    Ok(inputs)
}
