use std::path::PathBuf;

use cape_core::{Outfit, npy::write_npy, ply};
use cape_infer::{BodySpec, write_json};
use clap::Args;
use ndarray::{Array3, Axis, concatenate};
use serde::Serialize;

use crate::{
    console::Console,
    dressed_mesh::DressedRenderer,
    error::{Error, Result},
    files,
    options::{GlobalArgs, OutputArgs, RunArgs},
    registration::{KnownBodyArgs, RegistrationFile, mean_error},
    table::Table,
};

/// Encode registrations to latent codes.
///
/// Writes codes.npy, a row per registration, which other commands take as codes.npy:ROW, and
/// encode.json with codes, outfits and reconstruction errors.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape model encode runs/cape raw/sequences/s0001/longlong_squats/*.npz --out \
                  codes\n  cape model encode runs/cape frame:0 frame:40 --decode --out decoded"
)]
pub(crate) struct EncodeArgs {
    #[command(flatten)]
    run: RunArgs,
    /// Frames, .npz with pose and v_cano or v_posed, or frame:K for a test frame of the run.
    #[arg(value_name = "REGISTRATION")]
    registrations: Vec<String>,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    known: KnownBodyArgs,
    /// Also write the decoded bodies as coloured meshes.
    #[arg(long)]
    decode: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    /// Mean error at clothing vertices, millimetres.
    error_mm: f64,
    encoded: Vec<EncodedRegistration>,
}

#[derive(Debug, Serialize)]
struct EncodedRegistration {
    registration: String,
    outfit: Outfit,
    code: Vec<f32>,
    betas: Vec<f32>,
    /// RMS distance of the body of the fitted betas from the minimal shape, millimetres.
    residual_mm: Option<f64>,
    /// Mean error of the decoded clothing at clothing vertices, millimetres.
    error_mm: f64,
    mesh: Option<String>,
}

impl EncodeArgs {
    pub(crate) fn run(mut self, global: &GlobalArgs, console: Console) -> Result {
        if let Some(first) = self.run.take_other() {
            self.registrations.insert(0, first.to_string_lossy().into_owned());
        }
        if self.registrations.is_empty() {
            return Err(Error::message("REGISTRATION: missing: name frames to encode"));
        }
        self.output.require_empty()?;
        let out = self.output.out;
        let run = self.run.open(global)?;
        let total = self.registrations.len();
        let read: Vec<RegistrationFile> =
            console.while_showing("read", "registrations", |progress| {
                let each = self.registrations.iter().enumerate();
                each.map(|(index, text)| {
                    let registration = RegistrationFile::read(&run, text, &self.known)?;
                    progress(index + 1, total);
                    Ok(registration)
                })
                .collect::<Result<_>>()
            })?;
        let wearers: Vec<BodySpec> = read.iter().map(|one| one.wearer.clone()).collect();
        let worn: Vec<_> = read.iter().map(|one| one.displacement.view()).collect();
        let worn: Array3<f32> =
            concatenate(Axis(0), &worn).map_err(|error| Error::message(error.to_string()))?;
        let codes = run.encode(&worn, &wearers)?;
        let decoded = run.decode_displacements(&codes, &wearers)?;

        files::create_dir(&out)?;
        write_npy(out.join("codes.npy"), &codes)?;
        let mut meshes = vec![None; total];
        if self.decode {
            for (index, body) in
                DressedRenderer::new(&run).pose_clothed(&decoded, &wearers)?.iter().enumerate()
            {
                let name = format!("{index:04}.ply");
                ply::write(out.join(&name), &body.mesh, Some(&body.colours_8_bit()))?;
                meshes[index] = Some(name);
            }
        }
        let encoded: Vec<EncodedRegistration> = read
            .into_iter()
            .zip(self.registrations)
            .zip(meshes)
            .enumerate()
            .map(|(row, ((one, registration), mesh))| EncodedRegistration {
                registration,
                outfit: one.wearer.outfit,
                code: codes.row(row).to_vec(),
                betas: one.wearer.betas,
                residual_mm: one.residual_mm,
                error_mm: mean_error(&run, &worn, &decoded, row),
                mesh,
            })
            .collect();
        let error_mm = encoded.iter().map(|one| one.error_mm).sum::<f64>() / total.max(1) as f64;
        let report = Report { out, error_mm, encoded };
        write_json(&report.out.join("encode.json"), &report)?;
        console.result(&report, || report.text())
    }
}

impl Report {
    fn text(&self) -> String {
        let mut table = Table::new(["registration", "outfit", "code norm", "error, mm"]);
        for one in &self.encoded {
            let length = one.code.iter().map(|x| x * x).sum::<f32>().sqrt();
            table.row([
                one.registration.clone(),
                one.outfit.to_string(),
                format!("{length:.2}"),
                format!("{:.2}", one.error_mm),
            ]);
        }
        let codes = self.out.join("codes.npy");
        format!("{}\n\nmean error {:.2} mm\n{}", table.text(), self.error_mm, codes.display())
    }
}
