mod target;

use std::path::PathBuf;

use cape_core::{Outfit, parse_device, ply};
use cape_infer::{BodySpec, Run, write_json};
use cape_render::{Tile, View, contact_sheet};
use cape_synth::poses::poses;
use clap::Args;
use ndarray::{Axis, concatenate};
use serde::Serialize;

use self::target::{ClothingTransfer, TargetBody};

use crate::{
    arguments::{GlobalArgs, outfit},
    console::Console,
    dressed_mesh::DressedRenderer,
    error::{Error, Result},
    files,
    registration::{KnownBodyArgs, RegistrationFile, mean_error},
};

/// Reconstruct a registration, change its outfit and pose, or give its clothes to others.
///
/// Its clothes are encoded to a code, and decoded under the pose and outfit it has, under other
/// outfits, under other poses, and, with --to, on other bodies: in the pose of a registration, else
/// in its own, with what the model says of clothes in that pose; --exact moves the registered clothes
/// themselves. Writes coloured meshes, a picture and redress.json with the code and, for other
/// bodies, how the clothes sit.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape redress run raw/sequences/00032/shortlong_hips/000010.npz --out new\n  \
                  cape redress run frame:12 --outfit longlong --pose a-pose,squats --out new\n  \
                  cape redress run frame:12 --to frame:80 --to 2,-1 --out given"
)]
pub(crate) struct RedressArgs {
    /// A training run.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// A frame's .npz with pose and v_cano, or v_posed; or frame:K of the run's held-out data.
    #[arg(value_name = "REGISTRATION")]
    registration: String,
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    known: KnownBodyArgs,
    /// What is worn instead; by default each outfit.
    #[arg(long, value_delimiter = ',', value_name = "OUTFIT,…", value_parser = outfit)]
    outfit: Vec<Outfit>,
    /// Further poses, as for `cape sample`.
    #[arg(long, value_delimiter = ',', value_name = "POSE,…")]
    pose: Vec<String>,
    /// Another body to give the clothes to: shape coefficients, a body without clothes (.npy of
    /// [vertices, 3]) or a registration; may be repeated.
    #[arg(long, value_name = "BODY", allow_hyphen_values = true)]
    to: Vec<String>,
    /// Give the registered clothes themselves to other bodies, not what their code is decoded to.
    #[arg(long, requires = "to")]
    exact: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    outfit: Outfit,
    code: Vec<f32>,
    betas: Vec<f32>,
    /// Of the body that the betas describe, from the minimal one.
    residual_mm: Option<f64>,
    /// Mean error of the reconstruction at clothing vertices.
    error_mm: f64,
    /// How the clothes sit on other bodies.
    transferred: Vec<ClothingTransfer>,
    files: Vec<String>,
}

impl RedressArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let device = parse_device(&global.device)?;
        files::require_empty(&self.out)?;
        let mut others = Vec::new();
        for text in &self.pose {
            others.extend(poses(text)?);
        }
        let run = Run::open(&self.run, &device)?;
        let registration = RegistrationFile::read(&run, &self.registration, &self.known)?;
        let read = |text: &String| TargetBody::read(&run, text);
        let targets: Vec<TargetBody> = self.to.iter().map(read).collect::<Result<_>>()?;
        let wearer = &registration.wearer;
        let code = run.encode(&registration.displacement, std::slice::from_ref(wearer))?;

        let outfits = match &self.outfit[..] {
            // Other bodies are what is asked for then.
            [] if !targets.is_empty() => Vec::new(),
            [] => Outfit::ALL.to_vec(),
            chosen => chosen.to_vec(),
        };
        let mut changed = vec![("reconstruction".to_owned(), wearer.clone())];
        changed.extend(
            outfits
                .iter()
                .filter(|&&outfit| outfit != wearer.outfit)
                .map(|&outfit| (outfit.name().to_owned(), BodySpec { outfit, ..wearer.clone() })),
        );
        changed.extend(
            others.into_iter().map(|(name, pose)| (name, BodySpec { pose, ..wearer.clone() })),
        );
        let first_target = changed.len();
        changed.extend(
            targets.iter().map(|target| (format!("on {}", target.name), target.body_spec(wearer))),
        );
        let (names, wearers): (Vec<String>, Vec<BodySpec>) = changed.into_iter().unzip();
        let codes = code.select(Axis(0), &vec![0; wearers.len()]);
        let mut decoded = run.decode_displacements(&codes, &wearers)?;
        let error_mm = mean_error(&run, &registration.displacement, &decoded, 0);
        let registered = registration.displacement.index_axis(Axis(0), 0);
        if self.exact {
            for row in first_target..wearers.len() {
                decoded.index_axis_mut(Axis(0), row).assign(&registered);
            }
        }

        let worn = concatenate(Axis(0), &[registration.displacement.view(), decoded.view()])
            .map_err(|error| Error::message(error.to_string()))?;
        let all: Vec<BodySpec> = [wearer.clone()].into_iter().chain(wearers).collect();
        let mut bodies = DressedRenderer::new(&run).pose_clothed(&worn, &all)?;
        for (index, target) in targets.iter().enumerate() {
            let row = first_target + index;
            let worn = decoded.index_axis(Axis(0), row);
            bodies[1 + row].mesh = target.mesh(&run, &all[1 + row], worn)?;
        }
        let names = ["registration".to_owned()].into_iter().chain(names);
        files::create_dir(&self.out)?;
        let (mut tiles, mut written) = (Vec::new(), Vec::new());
        for (index, (name, body)) in names.zip(&bodies).enumerate() {
            let file = format!("{index}-{}.ply", name.replace(['/', ' '], "-"));
            ply::write(self.out.join(&file), &body.mesh, Some(&body.colours_8_bit()))?;
            tiles.push(Tile {
                image: body.picture(View::ThreeQuarter, [280, 400], None)?,
                label: name,
            });
            written.push(file);
        }
        let mut transferred = Vec::new();
        for (index, target) in targets.iter().enumerate() {
            let before = if self.exact { registered } else { decoded.index_axis(Axis(0), 0) };
            let file = written[1 + first_target + index].clone();
            transferred.push(target.measure(&run, &registration, before, file)?);
        }
        contact_sheet(&tiles, tiles.len().min(6), None)?.save(self.out.join("redress.png"))?;
        let report = Report {
            outfit: wearer.outfit,
            code: code.row(0).to_vec(),
            betas: wearer.betas.clone(),
            residual_mm: registration.residual_mm,
            error_mm,
            transferred,
            files: written,
            out: self.out,
        };
        write_json(&report.out.join("redress.json"), &report)?;
        console.result(&report, || {
            let out = report.out.display();
            let transferred: String =
                report.transferred.iter().map(ClothingTransfer::text).collect();
            format!(
                "reconstructed within {error_mm:.2} mm in the mean\n{transferred}{out}/redress.png"
            )
        })
    }
}
