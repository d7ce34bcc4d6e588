//! Measuring a row, and fitting those that are not trained.

use std::{sync::Arc, time::Instant};

use burn::tensor::Device;
use ndarray::{Array2, Axis};

use super::{FRAMES, FigureFrames, RESULT, RowResult, Table2Job, Table2Options, Table2Row};
use crate::{
    Error, Result,
    comparison::{RunErrorMeter, RunErrors, measure_run},
};
use cape_core::ProgressFn;
use cape_data::{DisplacementStatistics, PackedSet, Split, principal_components};
use cape_infer::Run;
use cape_stats::pca::PcaOptions;

const PCA: &str = "pca.npz";

impl Table2Job {
    /// Measures the row on the test frames and keeps the result; `seconds` is what its training
    /// took. Rows that are not trained are fitted here.
    pub fn measure(
        &self,
        grid: &Table2Options,
        seconds: f64,
        device: &Device,
        progress: &mut ProgressFn,
    ) -> Result<RowResult> {
        let start = Instant::now();
        let set = PackedSet::open(&grid.data, Split::Test)?;
        let mut frames = FigureFrames::new(&self.shown, set.vertices());
        let measured = if self.row.is_trained() {
            let run = Run::open(self.run_directory(), device)?;
            let set = Arc::new(set.with_vocabulary(run.outfits())?);
            measure_run(&run, &set, self.seed, progress, &mut |row, predicted, _| {
                frames.push(row, predicted);
                Ok(())
            })?
        } else {
            self.measure_fitted(grid, &set, &mut frames, progress)?
        };
        let result = RowResult {
            row: self.row,
            seed: self.seed,
            seconds: if self.row.is_trained() { seconds } else { start.elapsed().as_secs_f64() },
            measured,
        };
        // The result comes last: where it is, its frames are too.
        frames.save(self.store.claim(FRAMES)?)?;
        self.store.write(RESULT, &result)
    }

    fn measure_fitted(
        &self,
        grid: &Table2Options,
        set: &PackedSet,
        frames: &mut FigureFrames,
        progress: &mut ProgressFn,
    ) -> Result<RunErrors> {
        let (body, mask) = grid.body(set)?;
        let clothing: Vec<usize> = mask.indices().collect();
        let mut meter = RunErrorMeter::new(&body, &clothing);
        let reconstruct = self.fit_row(grid, progress)?;
        for row in 0..set.frames() {
            let truth = set.displacement_row(row)?;
            let predicted = reconstruct(&truth)?;
            let [predicted, truth] = [predicted, truth]
                .map(|values| values.iter().map(|&x| x as f32).collect::<Vec<_>>());
            meter.push_sampled(set, row, &predicted, &truth)?;
            meter.push_mean(set, row, &predicted, &truth)?;
            frames.push(row, &predicted);
            progress(row + 1, set.frames());
        }
        Ok(meter.errors())
    }

    /// The reconstruction of a row that is fitted, not trained.
    #[allow(clippy::type_complexity)]
    fn fit_row(
        &self,
        grid: &Table2Options,
        progress: &mut ProgressFn,
    ) -> Result<Box<dyn Fn(&[f64]) -> Result<Vec<f64>>>> {
        if self.row == Table2Row::Mean {
            let statistics = DisplacementStatistics::from_packed(&grid.data, progress)?;
            let mean: Vec<f64> = statistics.mean().iter().copied().collect();
            return Ok(Box::new(move |_| Ok(mean.clone())));
        }
        let set = PackedSet::open(&grid.data, Split::Train)?;
        let statistics = DisplacementStatistics::from_packed(&grid.data, &mut cape_core::silent)?;
        let rows = statistics.training_rows(set.frames()).len();
        // A small set has fewer directions than the paper's 18.
        let components = self.config.model.latent.min(rows.saturating_sub(1));
        let options = PcaOptions { components, seed: self.seed, ..PcaOptions::default() };
        let pca = principal_components(&grid.data, &options, progress)?;
        pca.save(self.store.claim(PCA)?)?;
        Ok(Box::new(move |truth| {
            let rows = Array2::from_shape_vec((1, truth.len()), truth.to_vec())
                .map_err(|error| Error::argument(error.to_string()))?;
            let decoded = pca.decode(pca.encode(rows.view())?.view())?;
            Ok(decoded.index_axis(Axis(0), 0).to_vec())
        }))
    }
}
