mod garment;
mod output;
mod picture;

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use cape_core::{motion::MotionOptions, npy::Npz};
use cape_fit::{
    BodyParameters, GarmentConfig, PosePrior,
    scan::{
        FreeFormConfig, FreeFormSurface, KnownJoints, RemovedElements, Scan, ScanConfig,
        ScanFitter, ScanInit, ScanUnit, UpAxis, free_displacement,
    },
};
use cape_synth::poses::load_poses;
use clap::Args;

use self::output::{OutputPaths, ScanOutput};
use crate::{
    console::{Console, seconds},
    error::{Context, Error, Result},
    options::{GlobalArgs, OutfitSelection, OutputArgs, RunArgs, non_negative, outfit_or},
    registration::read_shape,
};

/// Fit a clothed body to a scan, a point cloud or mesh with holes and noise.
///
/// Fits shape, pose, translation and latent code by robust distances in both directions, coarse to fine.
/// Writes bare.ply, clothed.ply, clothed.glb, fit.json, code.npy, pose.npy and minimal.npy for other
/// commands, and fit.png. --free-displacement then moves every vertex to the scan and adds the
/// registration to a raw tree for `cape data pack`. Unreliable fits are still written, but the command
/// exits with an error.
///
/// With --garment no body is fitted: the mesh of a garment is laid onto each scan of a directory, from the
/// frame before, as rigidly as the scans allow. Writes a mesh with the template's triangles for each scan,
/// garment.json and garment.png; `cape layer import` takes the directory.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape fit scan runs/cape --scan person.ply --outfit longlong --out \
                  fitted\n  cape fit scan runs/cape --scan person.obj --unit mm --up z --pose a-pose \
                  --free-displacement --out registered\n  cape fit scan --garment \
                  scans/skirt_01/0000.ply --scan scans/skirt_01 --out tracked"
)]
pub(crate) struct FitScanArgs {
    #[command(flatten)]
    run: RunArgs,
    /// Scan: .ply, .obj, .stl, .off or .glb, or .npz with POP's scan_pc; with --garment also a directory,
    /// whose names sort by frame.
    #[arg(long, value_name = "FILE")]
    scan: PathBuf,
    /// Mesh of a garment in the unit of the scans, near its place in the first one, to be laid onto all.
    #[arg(
        long,
        value_name = "MESH",
        conflicts_with_all = [
            "run", "outfit", "up", "pose", "joints", "initial", "minimal_shape", "pose_prior",
            "free_displacement", "subject", "sequence", "frame"
        ]
    )]
    garment: Option<PathBuf>,
    /// The scans are of the whole person: what lies beyond the edges of the garment does not draw it.
    #[arg(long, requires = "garment")]
    dressed: bool,
    #[command(flatten)]
    output: OutputArgs,
    /// Outfit of the run; auto fits all and keeps the one of lowest energy.
    #[arg(long, default_value = "auto", value_name = "OUTFIT", value_parser = outfit_or("auto"))]
    outfit: OutfitSelection,
    /// Unit of the scan: m, cm or mm; auto finds it out and scales a scan of unit size to 1.7 m.
    #[arg(long, default_value = "m", value_name = "UNIT")]
    unit: ScanUnit,
    /// Up axis of the scan: x, y, z, -x, -y or -z.
    #[arg(long, default_value = "y", allow_hyphen_values = true, value_name = "AXIS")]
    up: UpAxis,
    /// Approximate pose: t-pose, a-pose, a motion or a file [default: several are tried].
    #[arg(long, value_name = "POSE", conflicts_with_all = ["joints", "initial"])]
    pose: Option<String>,
    /// SMPL's 24 joints in the scan's coordinates, .npy or .json of [24, 3]; null if unknown.
    #[arg(long, value_name = "FILE", conflicts_with = "initial")]
    joints: Option<PathBuf>,
    /// Approximate body: fit.json, JSON with betas, pose and transl in metres, or a registered frame, .npz
    /// with pose and transl.
    #[arg(long, value_name = "FILE")]
    initial: Option<PathBuf>,
    /// Minimal body shape of the subject, .npy of [vertices, 3]; keeps the shape fixed.
    #[arg(long, value_name = "FILE.npy")]
    minimal_shape: Option<PathBuf>,
    /// Pose prior, SMPLify's .pkl or .npz of `cape fit pose-prior` [default: synthetic motions].
    #[arg(long, value_name = "FILE")]
    pose_prior: Option<PathBuf>,
    /// Move every vertex to the scan after the fit and write a registration.
    #[arg(long)]
    free_displacement: bool,
    /// Weight of the smoothness of free displacements.
    #[arg(long, default_value_t = 1.0, value_name = "WEIGHT", requires = "free_displacement", value_parser = non_negative)]
    smooth: f64,
    /// Raw tree to add the registration to [default: raw in --out].
    #[arg(long, value_name = "RAW", requires = "free_displacement")]
    raw: Option<PathBuf>,
    /// Name of the subject in the raw tree.
    #[arg(long, default_value = "subject", value_name = "NAME")]
    subject: String,
    /// Name of the sequence in the raw tree.
    #[arg(long, default_value = "scan", value_name = "NAME")]
    sequence: String,
    /// Number of the frame in the sequence.
    #[arg(long, default_value_t = 1, value_name = "N")]
    frame: usize,
}

impl FitScanArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        self.output.require_empty()?;
        if let Some(template) = &self.garment {
            let scans = (self.scan.as_path(), self.unit);
            let config = GarmentConfig {
                dressed: self.dressed,
                seed: global.seed(),
                ..GarmentConfig::default()
            };
            return garment::register(template, scans, config, &self.output.out, console);
        }
        let scan = Scan::load(&self.scan, self.unit)?;
        remark(&scan, console);
        let run = self.run.open(global)?;
        let outfits = self.outfit.of(&run)?;
        let prior = match &self.pose_prior {
            Some(path) => PosePrior::load(path)?,
            None => PosePrior::synthetic()?,
        };
        let start = self.start(&prior, scan.scale())?;
        let minimal = self.minimal_shape.as_deref();
        let minimal = minimal.map(|path| read_shape(path, run.body().vertices())).transpose()?;
        let seed = global.seed();
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
            console.note("warning: the scan's normals do not point outwards: flipped or ignored");
        }
        if let Some(problem) = &report.fit.problem {
            return Err(Error::message(format!(
                "the fit in {} is unreliable: {problem}",
                report.out.display()
            )));
        }
        console.result(&report, || text(&report))
    }

    /// Start of the fit; `metres` is the length of the scan's unit.
    fn start(&self, prior: &PosePrior, metres: f64) -> Result<ScanInit> {
        if let Some(path) = &self.initial {
            return Ok(ScanInit::Body(read_body(path)?));
        }
        if let Some(path) = &self.joints {
            return Ok(ScanInit::Joints(KnownJoints::load(path)?.scaled(metres)));
        }
        if let Some(text) = &self.pose {
            let file = load_poses(text, &MotionOptions::default())?;
            let chosen = file.upright_poses()?.into_iter();
            return Ok(ScanInit::Poses(chosen.map(|pose| pose.map(f64::from).to_vec()).collect()));
        }
        Ok(ScanInit::default_poses(prior))
    }
}

/// Says what was left out of a scan, and what is unusual about its size.
fn remark(scan: &Scan, console: Console) {
    let RemovedElements { points, faces } = scan.removed();
    if points > 0 {
        console.note(&format!(
            "{points} points of the scan are not finite: they and {faces} triangles at them are left out"
        ));
    }
    if let Some(remark) = scan.remark() {
        console.note(remark);
    }
}

/// Reads a body from JSON, alone or in the fit.json of a fit, or from a registered frame.
fn read_body(path: &Path) -> Result<BodyParameters> {
    if path.extension().is_some_and(|extension| extension == "npz") {
        return read_registration(path);
    }
    let text = std::fs::read(path).map_err(|error| Error::io(path, error))?;
    let fault = |error: serde_json::Error| cape_core::Error::format(path, error.to_string());
    let value: serde_json::Value = serde_json::from_slice(&text).map_err(fault)?;
    let places = ["/fit/parameters", "/clothed/parameters", "/parameters"];
    let body = places.iter().find_map(|place| value.pointer(place)).unwrap_or(&value);
    Ok(serde_json::from_value(body.clone()).map_err(fault)?)
}

/// Pose and translation of a registered frame, on the mean shape.
fn read_registration(path: &Path) -> Result<BodyParameters> {
    let mut frame = Npz::open(path)?;
    let pose = frame.f64("pose")?;
    frame.expect_shape("pose", pose.shape(), &[Some(72)])?;
    let transl = frame.f64("transl")?;
    frame.expect_shape("transl", transl.shape(), &[Some(3)])?;
    let mut body = BodyParameters::new(pose.into_iter().collect(), Vec::new())?;
    for (to, from) in body.transl.iter_mut().zip(transl) {
        *to = from;
    }
    Ok(body)
}

fn text(report: &OutputPaths) -> String {
    let distance = &report.fit.distance;
    let mut lines = vec![format!(
        "{} in {}: distance of the scan from the surface, median {:.1} mm, 95th percentile {:.1} mm",
        report.fit.outfit,
        seconds(report.seconds),
        distance.median,
        distance.most
    )];
    if distance.unseen > 0.1 {
        let unseen = 100.0 * distance.unseen;
        lines.push(format!("no scan points near {unseen:.0} % of the surface"));
    }
    if let Some(free) = &report.free {
        lines.push(format!(
            "free displacement of {:.1} mm on average: median {:.1} mm, 95th percentile {:.1} mm",
            free.moved_mm, free.distance.median, free.distance.most
        ));
        lines.push(free.registration.display().to_string());
    }
    lines.push(report.out.join("fit.png").display().to_string());
    lines.join("\n")
}
