use cape_eval::bench::{BenchReport, LaunchReport, bench, count_launches};
use cape_graph::{KernelLaunches, Precision};
use cape_infer::RunConfig;
use cape_model::CapeConfig;
use clap::Args;
use serde::Serialize;

use crate::{
    console::Console,
    error::{Error, Result},
    options::{GlobalArgs, PRESETS, PrecisionArgs, at_least_one, note_precision},
    table::Table,
};

/// Batch size from which on memory is unlikely to suffice on any machine.
const TOO_MANY: usize = 4096;

/// Measure the speed of training, decoding and encoding on this machine.
///
/// Times updates of generator and discriminator, decoding and encoding for a body of 6890 vertices on
/// random data, in less than two minutes. The arithmetic of an update is counted as the fewest
/// operations that it needs and compared with this CPU's peak FLOP rate.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape eval speed --threads 4 --json")]
pub(crate) struct SpeedArgs {
    /// Frames per batch.
    #[arg(long, default_value_t = 16, value_name = "N", value_parser = batch_size)]
    batch: usize,
    /// Architecture; narrow has a quarter of the paper's filters.
    #[arg(long, default_value = "paper", value_name = "NAME", value_parser = PRESETS)]
    preset: String,
    #[command(flatten)]
    precision: PrecisionArgs,
    /// Count the kernel launches of an update, of decoding and of encoding on a graphics card instead.
    #[arg(long)]
    count: bool,
}

fn batch_size(text: &str) -> Result<usize, String> {
    match at_least_one(text)? {
        TOO_MANY.. => Err(format!("must be less than {TOO_MANY}")),
        count => Ok(count),
    }
}

#[derive(Debug, Serialize)]
struct Report {
    version: &'static str,
    preset: String,
    device: String,
    precision: Precision,
    #[serde(flatten)]
    found: BenchReport,
}

impl SpeedArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let device = global.device()?;
        let precision = self.precision.precision.unwrap_or_default();
        note_precision(precision, &global.device, console);
        let mut run =
            RunConfig { model: CapeConfig::preset(&self.preset)?, ..RunConfig::default() };
        run.train.batch = self.batch;
        run.train.seed = global.seed();
        run.train.precision = precision;
        if self.count {
            if cape_core::is_cpu(&device) {
                return Err(Error::message(format!(
                    "--count: {} runs no kernels: give the device of a graphics card, such as --device wgpu",
                    global.device
                )));
            }
            let launches = console.while_showing("count", "runs", |progress| {
                count_launches(&run, &device, progress)
            })?;
            return console.result(&launches, || launches_text(&launches));
        }
        let found =
            console.while_showing("measure", "runs", |progress| bench(&run, &device, progress))?;
        let report = Report {
            version: env!("CARGO_PKG_VERSION"),
            preset: self.preset,
            device: global.device.clone(),
            precision,
            found,
        };
        console.result(&report, || report.text())
    }
}

/// Launches by kernel, those of updates first.
fn launches_text(found: &LaunchReport) -> String {
    let LaunchReport { update, decode, encode, batch } = found;
    let columns = [update, decode, encode];
    let mut names: Vec<&str> = Vec::new();
    for (name, _) in columns.iter().flat_map(|launches| &launches.kernels) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    let mut table = Table::new(["kernel", "update", "decode", "encode"]);
    let mut row = |name: &str, counts: [usize; 3]| {
        let [update, decode, encode] = counts.map(|count| count.to_string());
        table.row([name.to_owned(), update, decode, encode]);
    };
    for name in names {
        let of = |launches: &KernelLaunches| {
            launches.kernels.iter().find(|kernel| kernel.0 == name).map_or(0, |kernel| kernel.1)
        };
        row(name, columns.map(of));
    }
    row("all", columns.map(KernelLaunches::total));
    format!("{}\n\nkernel launches, batch {batch}", table.text())
}

impl Report {
    fn text(&self) -> String {
        let Self { version, preset, device, precision, found } = self;
        let or_dash = |text: Option<String>| text.unwrap_or_else(|| "–".to_owned());
        let mut table = Table::default();
        let mut row = |name: &str, value: String| table.row([name.to_owned(), value]);
        row(
            &format!("update, batch {}", found.batch),
            format!("{:.3} s", found.seconds_per_update),
        );
        row("examples per second", format!("{:.2}", found.examples_per_second));
        row("FLOP rate", or_dash(found.gflops.map(|rate| format!("{rate:.1} GFLOP/s"))));
        row(
            "peak FLOP rate of the CPU",
            or_dash(found.peak_gflops.map(|peak| format!("{peak:.1} GFLOP/s"))),
        );
        row(
            "share of the peak",
            or_dash(found.peak_fraction.map(|part| format!("{:.1} %", 100.0 * part))),
        );
        row("decode, batch 1", format!("{:.1} ms", found.decode_ms_batch1));
        row("decode, batch 16", format!("{:.1} ms", found.decode_ms_batch16));
        row("encode, batch 16", format!("{:.1} ms", found.encode_ms_batch16));
        row("peak memory", or_dash(found.peak_rss_mb.map(|mb| format!("{mb:.0} MB"))));
        let threads = match found.threads {
            1 => "1 thread".to_owned(),
            threads => format!("{threads} threads"),
        };
        let work = found
            .gflop_per_update
            .map_or_else(String::new, |gflop| format!(" of {gflop:.1} GFLOP each"));
        let products = match precision {
            Precision::F32 => "",
            Precision::Bf16 => ", products in bf16",
        };
        format!(
            "{}\n\ncape {version}, {preset} model on {device}, {threads}{products}; median of {} updates{work}",
            table.text(),
            found.updates
        )
    }
}
