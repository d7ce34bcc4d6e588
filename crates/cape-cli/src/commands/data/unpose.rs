use std::path::PathBuf;

use cape_core::smpl::Gender;
use cape_data::unpose::{UnposeReport, unpose};
use clap::Args;
use serde::Serialize;

use crate::{
    body_source::{GENDERS, SubjectModels},
    console::Console,
    error::{Error, Result},
    options::{OutputArgs, at_least_one, choices},
    table::Table,
};

/// Unpose registrations of your own for packing.
///
/// Reads frames with v_posed, pose and transl in the raw layout and writes them with v_cano. Every
/// subject needs a minimal body shape; the shape coefficients fitted to it are reported with their
/// residual.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  cape data unpose scans --body data/smpl/SMPL_MALE.pkl --out raw"
)]
pub(crate) struct UnposeArgs {
    /// Raw data, with sequences/ and minimal_body_shape/.
    #[arg(value_name = "RAW")]
    raw: PathBuf,
    /// Body of the registrations: an SMPL body (.pkl or .npz), a built-in one (male, female, neutral or
    /// sculpted), or with --gender one of a directory; a directory without --gender gives its male and
    /// female bodies [default: those of RAW].
    #[arg(long, value_name = "BODY")]
    body: Option<PathBuf>,
    /// Gender of the body in the directory of --body, or in $SMPL_MODELS without --body.
    #[arg(long, value_name = "GENDER", value_parser = choices(GENDERS))]
    gender: Option<Gender>,
    #[command(flatten)]
    output: OutputArgs,
    /// Number of shape coefficients to fit.
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
        let models = match SubjectModels::given(self.body.as_deref(), self.gender)? {
            Some(models) => Some(models),
            None => SubjectModels::of_data(&self.raw)?,
        };
        let Some(models) = models else {
            return Err(Error::message(format!(
                "{}: no body in it: give that of the registrations by --body",
                self.raw.display()
            )));
        };
        let unposed = console.while_showing("unpose", "frames", |progress| {
            unpose(&self.raw, &self.output.out, models.bodies(), self.betas, progress)
        })?;
        for (_, reason) in &unposed.broken {
            console.note(&format!("left out {reason}"));
        }
        let report = Report { out: self.output.out, unposed };
        console.result(&report, || report.text())
    }
}

impl Report {
    fn text(&self) -> String {
        let UnposeReport { subjects, frames, displacement_mm, broken } = &self.unposed;
        let mut table = Table::new(["subject", "frames", "residual, mm", "betas"]);
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
            "{}\n\n{frames} frames, {} left out; mean displacement {displacement_mm:.1} mm\n\n{out}\nnext: \
             cape data inspect {out}; cape data pack {out} --split FILE --out packed",
            table.text(),
            broken.len()
        )
    }
}
