mod target;

use std::path::PathBuf;

use cape_core::{Outfit, ply};
use cape_infer::{BodySpec, write_json};
use cape_render::{Tile, View, contact_sheet};
use clap::Args;
use ndarray::{Axis, concatenate};
use serde::Serialize;

use self::target::{TargetBody, TransferReport};

use crate::{
    console::Console,
    dressed_mesh::DressedRenderer,
    error::{Error, Result},
    files,
    motion_source::MotionFileArgs,
    options::{GlobalArgs, OutputArgs, RunArgs},
    priors::OutfitChangeArgs,
    registration::{KnownBodyArgs, RegistrationFile, mean_error},
};

/// Change outfit and pose of a registration, or transfer its clothing to other bodies.
///
/// Encodes the clothing to a latent code and decodes it in the registration's own pose and outfit, in
/// other outfits and poses, and with --to on other bodies. For another outfit the code is moved to its place
/// among that outfit's codes, unless --same-code is given. Writes coloured meshes, redress.png and
/// redress.json with the code, the reconstruction error and the fit on other bodies.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  cape redress runs/cape \
                  raw/sequences/s0001/longlong_squats/longlong_squats.000001.npz --out redressed\n  \
                  cape redress runs/cape frame:12 --outfit longlong --pose a-pose,squats --out posed\n  \
                  cape redress runs/cape frame:12 --to frame:20 --to 2,-1 --out given")]
#[command(allow_missing_positional = true)]
pub(crate) struct RedressArgs {
    #[command(flatten)]
    run: RunArgs,
    /// Frame, .npz with pose and v_cano or v_posed; .smpl with vertexOffsets; or frame:K for a test
    /// frame of the run.
    #[arg(value_name = "REGISTRATION")]
    registration: String,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    known: KnownBodyArgs,
    /// Other outfits of the run [default: all, or none with --to].
    #[arg(long, value_delimiter = ',', value_name = "OUTFIT,…")]
    outfit: Vec<Outfit>,
    #[command(flatten)]
    change: OutfitChangeArgs,
    /// Other poses: t-pose, a-pose, motions or files.
    #[arg(long, value_delimiter = ',', value_name = "POSE,…")]
    pose: Vec<String>,
    #[command(flatten)]
    poses: MotionFileArgs,
    /// Other body: betas, minimal shape (.npy) or registration; may be repeated.
    #[arg(long, value_name = "BODY", allow_hyphen_values = true)]
    to: Vec<String>,
    /// Transfer the registered displacements instead of decoded ones.
    #[arg(long, requires = "to")]
    exact: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    outfit: Outfit,
    code: Vec<f32>,
    betas: Vec<f32>,
    /// RMS distance of the body of the fitted betas from the minimal shape, millimetres.
    residual_mm: Option<f64>,
    /// Mean error of the reconstruction at clothing vertices, millimetres.
    error_mm: f64,
    /// Clothing on other bodies.
    transferred: Vec<TransferReport>,
    files: Vec<String>,
}

impl RedressArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        self.output.require_empty()?;
        let out = self.output.out;
        let mut others = Vec::new();
        for text in &self.pose {
            let file = self.poses.poses(text, console)?;
            let poses = file.upright_poses()?;
            others.extend((0..file.frames()).map(|at| (file.pose_name(at), poses[at])));
        }
        let run = self.run.open(global)?;
        let registration = RegistrationFile::read(&run, &self.registration, &self.known)?;
        let read = |text: &String| TargetBody::read(&run, text);
        let targets: Vec<TargetBody> = self.to.iter().map(read).collect::<Result<_>>()?;
        let wearer = &registration.wearer;
        let code = run.encode(&registration.displacement, std::slice::from_ref(wearer))?;

        let outfits = match &self.outfit[..] {
            [] if !targets.is_empty() => Vec::new(),
            [] => run.outfits().to_vec(),
            chosen => {
                chosen.iter().try_for_each(|&outfit| run.outfits().require(outfit).map(drop))?;
                chosen.to_vec()
            }
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
        let worn: Vec<Outfit> = wearers.iter().map(|wearer| wearer.outfit).collect();
        let codes = self.change.codes(&run, &code.row(0).to_vec(), wearer.outfit, &worn)?;
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
        files::create_dir(&out)?;
        let (mut tiles, mut written) = (Vec::new(), Vec::new());
        for (index, (name, body)) in names.zip(&bodies).enumerate() {
            let file = format!("{index}-{}.ply", name.replace(['/', ' '], "-"));
            ply::write(out.join(&file), &body.mesh, Some(&body.colours_8_bit()))?;
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
        contact_sheet(&tiles, tiles.len().min(6), None)?.save(out.join("redress.png"))?;
        let report = Report {
            outfit: wearer.outfit,
            code: code.row(0).to_vec(),
            betas: wearer.betas.clone(),
            residual_mm: registration.residual_mm,
            error_mm,
            transferred,
            files: written,
            out,
        };
        write_json(&report.out.join("redress.json"), &report)?;
        console.result(&report, || {
            let out = report.out.display();
            let transferred: String = report.transferred.iter().map(TransferReport::text).collect();
            format!("mean reconstruction error {error_mm:.2} mm\n{transferred}{out}/redress.png")
        })
    }
}
