use std::path::PathBuf;

use cape_core::SmplModel;
use cape_data::unpose::{UnposeReport, unpose};
use clap::Args;
use serde::Serialize;

use crate::{arguments::at_least_one, console::Console, error::Result, table::Table};

/// Unpose registrations of your own, so that they can be packed.
///
/// Reads frames with v_posed, pose and transl in the raw layout, and writes them with v_cano. Each
/// subject's minimal shape must be there; the shape coefficients nearest to it are reported, with
/// what they leave.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape unpose scans --body SMPL_MALE.pkl --out raw")]
pub(crate) struct UnposeArgs {
    /// Raw data: sequences/SUBJECT/OUTFIT_SEQUENCE/*.npz and
    /// minimal_body_shape/SUBJECT/SUBJECT_minimal.npy.
    #[arg(value_name = "RAW")]
    raw: PathBuf,
    /// The body that the meshes are registered to, .pkl or .npz.
    #[arg(long, value_name = "SMPL")]
    body: PathBuf,
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Shape coefficients to fit.
    #[arg(long, default_value_t = 10, value_name = "N", value_parser = at_least_one)]
    betas: usize,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    #[serde(flatten)]
    unposed: UnposeReport,
}

impl UnposeArgs {
    pub(crate) fn run(self, console: Console) -> Result {
        let body = SmplModel::load(&self.body)?;
        let unposed = console.while_showing("unpose", "frames", |progress| {
            unpose(&self.raw, &self.out, &body, self.betas, progress)
        })?;
        for (_, reason) in &unposed.broken {
            console.note(&format!("left out {reason}"));
        }
        let report = Report { out: self.out, unposed };
        console.result(&report, || report.text())
    }
}

impl Report {
    fn text(&self) -> String {
        let UnposeReport { subjects, frames, displacement_mm, broken } = &self.unposed;
        let mut table = Table::new(["subject", "frames", "residual mm", "betas"]);
        for subject in subjects {
            let betas: Vec<String> = subject.betas.iter().map(|b| format!("{b:.2}")).collect();
            table.row([
                subject.subject.clone(),
                subject.frames.to_string(),
                format!("{:.2}", subject.residual_mm),
                betas.join(","),
            ]);
        }
        let out = self.out.display();
        format!(
            "{}\n\n{frames} frames, {} left out, displacements of {displacement_mm:.1} mm on \
             average\n\n{out}\nnext: cape inspect {out}; cape pack {out} --split FILE --out packed",
            table.text(),
            broken.len()
        )
    }
}
