//! Benchmark of training updates, decoding and encoding on the neutral body, compared with the
//! peak FLOP rate of the processor.

mod memory;
pub(crate) mod timing;
mod workload;

use std::time::Duration;

use burn::tensor::Device;
use cape_graph::{KernelLaunches, peak_gflops};
use cape_infer::RunConfig;
use cape_model::update_flops;
use serde::Serialize;

use crate::Result;
use cape_core::{ProgressFn, smpl::Gender};
use cape_synth::embedded_body;
use timing::TimingOptions;

pub use memory::{peak_rss_mb, rss_mb};
pub use workload::{InferenceWorkload, Workload};

/// Timing of updates, which can take seconds each.
const UPDATES: TimingOptions =
    TimingOptions { warm_up: 2, most: 10, least: 3, budget: Duration::from_secs(40) };
/// Timing of decoding and encoding.
const INFERENCES: TimingOptions =
    TimingOptions { warm_up: 2, most: 20, least: 3, budget: Duration::from_secs(5) };
/// Batch size of decoding and encoding.
const INFERENCE_BATCH: usize = 16;

/// Report of [`bench`](bench()). Times are medians.
///
/// An example, not run because it takes a minute:
///
/// ```no_run
/// use burn::tensor::Device;
/// use cape_core::silent;
/// use cape_eval::bench::bench;
/// use cape_infer::RunConfig;
///
/// // The paper's model and batches of 16.
/// let report = bench(&RunConfig::default(), &Device::default(), &mut silent)?;
/// println!("{:.2} s an update, {:?} GFLOP/s", report.seconds_per_update, report.gflops);
/// # Ok::<(), cape_train::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BenchReport {
    /// Time of one update of generator and discriminator, seconds.
    pub seconds_per_update: f64,
    /// Training examples of the generator per second.
    pub examples_per_second: f64,
    /// FLOP rate of updates, 10⁹ operations per second, by [`update_flops`]; `None` for
    /// architectures that it does not count.
    pub gflops: Option<f64>,
    /// Ratio of [`gflops`](Self::gflops) to [`peak_gflops`](Self::peak_gflops).
    pub peak_fraction: Option<f64>,
    /// Peak FLOP rate of all threads of the processor for multiply-adds in registers, 10⁹
    /// operations per second; `None` on other devices.
    pub peak_gflops: Option<f64>,
    /// Operations of one update, 10⁹; `None` for architectures that are not counted.
    pub gflop_per_update: Option<f64>,
    /// Time of decoding 1 example, milliseconds.
    pub decode_ms_batch1: f64,
    /// Time of decoding 16 examples, milliseconds.
    pub decode_ms_batch16: f64,
    /// Time of encoding 16 examples, milliseconds.
    pub encode_ms_batch16: f64,
    /// Peak resident memory of the process, 10⁶ bytes; `None` if the operating system does not
    /// report it.
    pub peak_rss_mb: Option<f64>,
    /// Batch size of updates.
    pub batch: usize,
    /// Number of threads of the processor.
    pub threads: usize,
    /// Number of timed updates.
    pub updates: usize,
}

/// Measures the model of a run with its losses, batch size and precision, on random data and `device`. It
/// takes at most two minutes if an update takes at most ten seconds.
pub fn bench(run: &RunConfig, device: &Device, progress: &mut ProgressFn) -> Result<BenchReport> {
    let total = 2 + UPDATES.runs() + 3 * INFERENCES.runs();
    let mut steps = StepCounter { done: 0, total, progress };
    let body = embedded_body(Gender::Neutral)?;
    let mut workload = Workload::of_run(run, &body, device)?;
    steps.to(1);
    let peak = cape_core::devices().contains(device).then(peak_gflops);
    steps.to(2);
    let update = UPDATES.time(|| workload.update(), || steps.next())?;
    let mut inference = |stage: usize, batch: usize, work: fn(&InferenceWorkload) -> Result<()>| {
        steps.to(2 + UPDATES.runs() + stage * INFERENCES.runs());
        let model = workload.inference(batch);
        let timing = INFERENCES.time(|| work(&model), || steps.next())?;
        Ok::<_, crate::Error>(1e3 * timing.seconds)
    };
    let decode_ms_batch1 = inference(0, 1, InferenceWorkload::decode)?;
    let decode_ms_batch16 = inference(1, INFERENCE_BATCH, InferenceWorkload::decode)?;
    let encode_ms_batch16 = inference(2, INFERENCE_BATCH, InferenceWorkload::encode)?;
    steps.to(total);

    let graphs = workload.graphs();
    let adversary = graphs.discriminator.as_ref().map_or(&[][..], |graph| graph.vertices());
    let batch = run.train.batch;
    let gflop = update_flops(&run.model, graphs.generator.vertices(), adversary, batch)
        .map(|operations| 1e-9 * operations);
    let gflops = gflop.map(|gflop| gflop / update.seconds);
    Ok(BenchReport {
        seconds_per_update: update.seconds,
        examples_per_second: batch as f64 / update.seconds,
        gflops,
        peak_fraction: gflops.zip(peak).map(|(gflops, peak)| gflops / peak),
        peak_gflops: peak,
        gflop_per_update: gflop,
        decode_ms_batch1,
        decode_ms_batch16,
        encode_ms_batch16,
        peak_rss_mb: peak_rss_mb(),
        batch,
        threads: rayon::current_num_threads(),
        updates: update.runs,
    })
}

/// Kernel launches of [`count_launches`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LaunchReport {
    /// Launches of one update of generator and discriminator.
    pub update: KernelLaunches,
    /// Launches of decoding a batch.
    pub decode: KernelLaunches,
    /// Launches of encoding a batch.
    pub encode: KernelLaunches,
    /// Batch size.
    pub batch: usize,
}

/// Counts the kernel launches of the workloads of [`bench()`] on a graphics card. Each is run twice, and the
/// second one counts.
pub fn count_launches(
    run: &RunConfig,
    device: &Device,
    progress: &mut ProgressFn,
) -> Result<LaunchReport> {
    fn of_second(mut work: impl FnMut() -> Result<()>) -> Result<KernelLaunches> {
        work()?;
        let (result, launches) = KernelLaunches::during(work);
        result.map(|()| launches)
    }
    let body = embedded_body(Gender::Neutral)?;
    let mut workload = Workload::of_run(run, &body, device)?;
    progress(1, 4);
    let update = of_second(|| workload.update())?;
    progress(2, 4);
    let batch = run.train.batch;
    let inference = workload.inference(batch);
    let decode = of_second(|| inference.decode())?;
    progress(3, 4);
    let encode = of_second(|| inference.encode())?;
    progress(4, 4);
    Ok(LaunchReport { update, decode, encode, batch })
}

/// Progress of a benchmark.
struct StepCounter<'a, 'b> {
    done: usize,
    total: usize,
    progress: &'a mut ProgressFn<'b>,
}

impl StepCounter<'_, '_> {
    fn next(&mut self) {
        self.to(self.done + 1);
    }

    fn to(&mut self, done: usize) {
        self.done = done;
        (self.progress)(done, self.total);
    }
}

#[cfg(test)]
mod tests {
    use cape_model::CapeConfig;

    use super::*;

    #[test]
    fn a_tiny_model_is_measured() {
        let device = cape_core::devices().remove(0);
        let mut seen = Vec::new();
        let mut run = RunConfig { model: CapeConfig::tiny(), ..RunConfig::default() };
        run.train.batch = 1;
        let report = bench(&run, &device, &mut |done, total| {
            seen.push((done, total));
        })
        .unwrap();
        assert!(report.seconds_per_update > 0.0 && report.gflops > Some(0.0), "{report:?}");
        assert!(seen.is_sorted() && seen.last().is_some_and(|(done, total)| done == total));
        assert!(Workload::new(&CapeConfig::tiny(), 0, 1, &device).is_err());
    }
}
