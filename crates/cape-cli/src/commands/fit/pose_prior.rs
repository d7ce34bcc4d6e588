use std::path::PathBuf;

use cape_fit::{BODY_POSE, COMPONENTS, OPTIONS, PoseCollection, PosePrior};
use cape_stats::density::MixtureOptions;
use clap::Args;
use ndarray::Array2;
use serde::Serialize;

use crate::{
    console::Console,
    error::Result,
    options::{GlobalArgs, at_least_one, positive, require_extension},
    table::Table,
};

/// Fit a pose prior for `cape fit` to poses of your own.
///
/// Fits a Gaussian mixture over the axis-angles of 23 joints, as in SMPLify. Sources are motions (AMASS,
/// results of pose estimators, .npz, .npy, .pkl, .json, .csv, .smpl), of all people in them, directories,
/// which are searched for such files, and packed sets, of which the training poses are used. Files in
/// directories without poses are left out and listed with the reason.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  cape fit pose-prior AMASS/CMU --components 8 --out prior.npz\n  cape \
                        fit image runs/cape person_keypoints.json --mask person_mask.png --pose-prior \
                        prior.npz --out fitted"
)]
pub(crate) struct FitPosePriorArgs {
    /// Motions, directories of motions, or packed sets.
    #[arg(value_name = "FILE|DIR", required = true)]
    sources: Vec<PathBuf>,
    /// Number of Gaussians.
    #[arg(long, default_value_t = COMPONENTS, value_name = "K", value_parser = at_least_one)]
    components: usize,
    /// Largest number of poses to fit to, evenly spaced.
    #[arg(long, default_value_t = 20_000, value_name = "N", value_parser = at_least_one)]
    poses: usize,
    /// Regularisation of variances, as a share of the poses' mean variance.
    #[arg(long, default_value_t = OPTIONS.regularisation, value_name = "SHARE", value_parser = positive)]
    floor: f64,
    /// File to write.
    #[arg(long, value_name = "FILE.npz")]
    out: PathBuf,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    files: usize,
    /// Number of files in directories that hold no poses.
    skipped: usize,
    poses: usize,
    fitted: usize,
    components: usize,
    weights: Vec<f64>,
    /// Mean energy `E_θ` of the fitted poses.
    energy: f64,
    /// Mean energy `E_θ` of the remaining poses, if there are any.
    held_out_energy: Option<f64>,
}

impl FitPosePriorArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        require_extension("--out", &self.out, "npz")?;
        let collection = console.while_showing("read", "files", |progress| {
            PoseCollection::read(&self.sources, progress)
        })?;
        for (path, reason) in &collection.skipped {
            console.note(&format!("left out {}: {reason}", path.display()));
        }
        let [poses, others] = collection.spread(self.poses);
        let options = MixtureOptions {
            regularisation: self.floor,
            seed: global.seed.unwrap_or(OPTIONS.seed),
            ..OPTIONS
        };
        let prior = console.while_showing("fit", "mixtures", |progress| {
            progress(0, 1);
            PosePrior::fit(poses.view(), self.components, &options)
        })?;
        prior.save(&self.out)?;
        let report = Report {
            files: collection.files,
            skipped: collection.skipped.len(),
            poses: collection.len(),
            fitted: poses.nrows(),
            components: prior.components(),
            weights: prior.weights().to_vec(),
            energy: mean_energy(&prior, &poses),
            held_out_energy: (others.nrows() > 0).then(|| mean_energy(&prior, &others)),
            out: self.out,
        };
        console.result(&report, || report.text())
    }
}

fn mean_energy(prior: &PosePrior, poses: &Array2<f64>) -> f64 {
    let energy = |pose: ndarray::ArrayView1<'_, f64>| {
        prior.energy(&pose.to_vec()[3..], 0.0, &mut [0.0; BODY_POSE])
    };
    poses.rows().into_iter().map(energy).sum::<f64>() / poses.nrows().max(1) as f64
}

impl Report {
    fn text(&self) -> String {
        let mut table = Table::default();
        table.row(["poses".to_owned(), format!("{} in {} files", self.poses, self.files)]);
        table.row(["poses fitted".to_owned(), self.fitted.to_string()]);
        let weights: Vec<String> = self.weights.iter().map(|w| format!("{w:.3}")).collect();
        table.row(["weights".to_owned(), weights.join(" ")]);
        table.row(["mean energy".to_owned(), format!("{:.1}", self.energy)]);
        if let Some(energy) = self.held_out_energy {
            table.row(["mean energy of other poses".to_owned(), format!("{energy:.1}")]);
        }
        format!("{}\n\n{}", table.text(), self.out.display())
    }
}
