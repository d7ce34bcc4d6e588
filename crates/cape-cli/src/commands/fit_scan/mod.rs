mod output;
mod picture;

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use cape_core::{Outfit, parse_device};
use cape_fit::{
    BodyParameters, PosePrior,
    scan::{
        FreeFormConfig, FreeFormSurface, KnownJoints, Scan, ScanConfig, ScanFitter, ScanInit, Unit,
        UpAxis, free_displacement,
    },
};
use cape_infer::Run;
use cape_synth::poses;
use clap::Args;

use self::output::{OutputPaths, ScanOutput};
use crate::{
    arguments::GlobalArgs,
    console::{Console, seconds},
    error::{Context, Error, Result},
    files,
    registration::read_shape,
};

/// Fit a clothed body to a scan: points or a mesh, with holes and noise.
///
/// Finds shape, pose, place and clothes by robust distances both ways, from coarse to fine. Writes
/// the bare and the clothed body as meshes, the clothed one as glTF too, fit.json, the code and the
/// pose for other commands, and fit.png. With --free-displacement every vertex then goes where the
/// scan is, and the registration is written into a raw tree that `cape pack` takes. A fit that
/// cannot be trusted is written too, and is an error. `cape fit RUN --scan FILE` is the same.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape fit-scan run --scan person.ply --outfit longlong --out fitted\n  \
                  cape fit-scan run --scan person.obj --unit mm --up z --pose a-pose \
                  --free-displacement --out fitted"
)]
pub(crate) struct FitScanArgs {
    /// A training run.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// The scan, .ply or .obj.
    #[arg(long, value_name = "FILE")]
    scan: PathBuf,
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// What is worn; with `auto`, what explains the scan best.
    #[arg(long, default_value = "auto", value_name = "OUTFIT|auto")]
    outfit: String,
    /// What the scan is measured in: m, cm or mm.
    #[arg(long, default_value = "m", value_parser = unit, value_name = "UNIT")]
    unit: Unit,
    /// The axis towards the head: x, y, z, -x, -y or -z.
    #[arg(long, default_value = "y", value_parser = up, allow_hyphen_values = true, value_name = "AXIS")]
    up: UpAxis,
    /// A rough pose, as for `cape sample`; by default what people often do is tried.
    #[arg(long, value_name = "POSE", conflicts_with_all = ["joints", "initial"])]
    pose: Option<String>,
    /// SMPL's 24 joints in the scan's space and unit, .npy or .json of [24, 3]; null if unknown.
    #[arg(long, value_name = "FILE", conflicts_with = "initial")]
    joints: Option<PathBuf>,
    /// A body roughly in place, metres: fit.json, or JSON with transl, pose and betas.
    #[arg(long, value_name = "FILE.json")]
    initial: Option<PathBuf>,
    /// The subject's body without clothes, .npy of [vertices, 3]: its shape is not solved for.
    #[arg(long, value_name = "FILE.npy")]
    minimal_shape: Option<PathBuf>,
    /// The pose prior: SMPLify's pickle, or .npz; by default one of synthetic movements.
    #[arg(long, value_name = "FILE")]
    pose_prior: Option<PathBuf>,
    /// Then let every vertex go where the scan is, and write a registration.
    #[arg(long)]
    free_displacement: bool,
    /// How smooth that displacement is.
    #[arg(long, default_value_t = 1.0, value_name = "WEIGHT", requires = "free_displacement")]
    smooth: f64,
    /// Raw tree that the registration is added to; by default raw in --out.
    #[arg(long, value_name = "RAW", requires = "free_displacement")]
    raw: Option<PathBuf>,
    /// The subject's name in it.
    #[arg(long, default_value = "subject", value_name = "NAME")]
    subject: String,
    /// The sequence's name in it.
    #[arg(long, default_value = "scan", value_name = "NAME")]
    sequence: String,
    /// The frame's number in the sequence.
    #[arg(long, default_value_t = 1, value_name = "N")]
    frame: usize,
}

impl FitScanArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let device = parse_device(&global.device)?;
        files::require_empty(&self.out)?;
        let outfits = match self.outfit.as_str() {
            "auto" => Outfit::ALL.to_vec(),
            name => vec![name.parse::<Outfit>()?],
        };
        let scan = Scan::load(&self.scan, self.unit)?;
        let run = Run::open(&self.run, &device)?;
        let prior = match &self.pose_prior {
            Some(path) => PosePrior::load(path)?,
            None => PosePrior::synthetic()?,
        };
        let start = self.start(&prior)?;
        let minimal = self.minimal_shape.as_deref();
        let minimal = minimal.map(|path| read_shape(path, run.body().vertices())).transpose()?;
        let seed = global.seed.unwrap_or(1);
        let config = ScanConfig { seed, ..ScanConfig::default() };
        let fitter = ScanFitter::new(&run, &outfits, minimal.as_ref(), prior, config)?;

        let clock = Instant::now();
        let fit = console
            .while_showing("fit", "steps", |progress| fitter.fit(&scan, &start, self.up, progress))
            .doing(|| format!("fitting {}", self.scan.display()))?;
        let surface = fitter.surface(&fit)?;
        let free = if self.free_displacement {
            let config = FreeFormConfig { smooth: self.smooth, seed, ..FreeFormConfig::default() };
            let faces = &run.body().faces;
            let found: FreeFormSurface =
                console.while_showing("displace", "steps", |progress| {
                    free_displacement(&scan, &surface, faces, &config, progress)
                })?;
            Some(found)
        } else {
            None
        };
        let took = clock.elapsed().as_secs_f64();

        let outcome =
            ScanOutput { run: &run, fitter: &fitter, scan: &scan, fit, surface, free, up: self.up };
        let report = outcome.write(&self, took)?;
        if !report.fit.normals_as_given {
            console.note("the scan's normals do not point outwards: they were turned or left out");
        }
        if let Some(problem) = &report.fit.problem {
            return Err(Error::message(format!(
                "the fit in {} cannot be trusted: {problem}",
                report.out.display()
            )));
        }
        console.result(&report, || text(&report))
    }

    fn start(&self, prior: &PosePrior) -> Result<ScanInit> {
        if let Some(path) = &self.initial {
            return Ok(ScanInit::Body(read_body(path)?));
        }
        if let Some(path) = &self.joints {
            let metres = self.unit.metres();
            return Ok(ScanInit::Joints(KnownJoints::load(path)?.scaled(metres)));
        }
        if let Some(text) = &self.pose {
            let chosen = poses::poses(text)?.into_iter();
            return Ok(ScanInit::Poses(
                chosen.map(|(_, pose)| pose.map(f64::from).to_vec()).collect(),
            ));
        }
        Ok(ScanInit::default_poses(prior))
    }
}

fn unit(text: &str) -> Result<Unit, String> {
    text.parse().map_err(|error: cape_fit::Error| error.to_string())
}

fn up(text: &str) -> Result<UpAxis, String> {
    text.parse().map_err(|error: cape_fit::Error| error.to_string())
}

/// A body in JSON: on its own, or as of a fit.
fn read_body(path: &Path) -> Result<BodyParameters> {
    let text = std::fs::read(path).map_err(|error| Error::io(path, error))?;
    let fault = |error: serde_json::Error| cape_core::Error::format(path, error.to_string());
    let value: serde_json::Value = serde_json::from_slice(&text).map_err(fault)?;
    let places = ["/fit/parameters", "/clothed/parameters", "/parameters"];
    let body = places.iter().find_map(|place| value.pointer(place)).unwrap_or(&value);
    Ok(serde_json::from_value(body.clone()).map_err(fault)?)
}

fn text(report: &OutputPaths) -> String {
    let distance = &report.fit.distance;
    let mut lines = vec![format!(
        "{} in {}: half of the scan within {:.1} mm of the surface, 95 % within {:.1} mm",
        report.fit.outfit,
        seconds(report.seconds),
        distance.median,
        distance.most
    )];
    if distance.unseen > 0.1 {
        let unseen = 100.0 * distance.unseen;
        lines.push(format!("the scan shows nothing of {unseen:.0} % of the surface"));
    }
    if let Some(free) = &report.free {
        lines.push(format!(
            "then displaced by {:.1} mm in the mean: half within {:.1} mm, 95 % within {:.1} mm",
            free.moved_mm, free.distance.median, free.distance.most
        ));
        lines.push(free.registration.display().to_string());
    }
    lines.push(report.out.join("fit.png").display().to_string());
    lines.join("\n")
}
