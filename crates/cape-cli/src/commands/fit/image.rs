use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use cape_core::{Outfit, npy::write_npy, ply};
use cape_fit::{
    BodyFit, ClothedConfig, ClothedFit, DressedBody, DressedSurface, FitConfig, FitProblem,
    FitWorkers, ImageObservation, KeypointLayout, KeypointOptions, Keypoints, Mask, PinholeCamera,
    Smplify, read_keypoints_with, silhouette::render,
};
use cape_infer::{AnimatedBody, BodySpec, Run, write_json};
use cape_render::{Image, Tile, contact_sheet};
use clap::Args;
use glam::DVec3;
use ndarray::{Array1, Array2};
use serde::Serialize;

use super::{
    drawing, folder,
    mask_input::{MaskArgs, PersonMask},
    method::FitMethodArgs,
    video::{self, VideoArgs},
};
use crate::{
    console::Console,
    dressed_mesh::{DressedMesh, DressedRenderer},
    error::{Context, Error, Result},
    exit_code::ExitCode,
    files,
    options::{GlobalArgs, OutfitSelection, OutputArgs, RunArgs, outfit_or, positive},
    table::Table,
};

/// Fit a clothed body to 2D keypoints and a silhouette (section 6.3 of the paper).
///
/// Fits the body by SMPLify, then body and clothing together. Writes bare.ply, clothed.ply, clothed.glb,
/// fit.json, code.npy and pose.npy for other commands, overlay.png and energy.png. Unreliable fits are
/// still written, but the command exits with an error.
///
/// With directories, each image of one name is fitted on a core of its own into a directory of --out,
/// with fits.jsonl and the contact sheet fits.png over all. Files that cannot be read are listed and
/// skipped. Run the same command again to resume.
///
/// With --sequence the images are the frames of a video: motion.npz for other commands, clothed.glb,
/// fits.jsonl, fits.png and sequence.json.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape fit image runs/cape person_keypoints.json --mask person_mask.png \
                        --outfit auto --out fitted\n  cape fit image runs/cape --keypoints keypoints --masks \
                        masks --images photos --out fitted\n  cape fit image runs/cape --keypoints keypoints \
                        --masks masks --sequence --fps 30 --out moving"
)]
pub(crate) struct FitArgs {
    #[command(flatten)]
    pub(super) run: RunArgs,
    /// 2D keypoints: JSON of OpenPose, COCO, AlphaPose, MMPose or MediaPipe, or .npz with `keypoints`; or
    /// a directory of such files.
    #[arg(value_name = "KEYPOINTS")]
    file: Option<PathBuf>,
    /// The same as an option.
    #[arg(long = "keypoints", value_name = "KEYPOINTS", conflicts_with = "file")]
    directory: Option<PathBuf>,
    #[command(flatten)]
    pub(super) mask: MaskArgs,
    #[command(flatten)]
    pub(super) output: OutputArgs,
    /// Outfit of the run; auto fits all and keeps the one of lowest energy.
    #[arg(long, default_value = "auto", value_name = "OUTFIT", value_parser = outfit_or("auto"))]
    pub(super) outfit: OutfitSelection,
    /// Fit the other outfits too and warn if one has a lower energy.
    #[arg(long, requires = "mask")]
    pub(super) compare_outfits: bool,
    /// Layout of the keypoints [default: by their number and the pose].
    #[arg(long, value_name = "LAYOUT")]
    pub(super) layout: Option<KeypointLayout>,
    /// Identifier or file name of the image in files of several images [default: the name of --image or
    /// --mask].
    #[arg(long, value_name = "ID")]
    pub(super) image_id: Option<String>,
    /// Index of the person, from 0, if the file has several [default: the one on the mask].
    #[arg(long, value_name = "N")]
    pub(super) person: Option<usize>,
    /// Focal length in pixels [default: the image's diagonal].
    #[arg(long, value_name = "PIXELS", value_parser = positive)]
    pub(super) focal: Option<f64>,
    #[command(flatten)]
    pub(super) video: VideoArgs,
    #[command(flatten)]
    pub(super) method: FitMethodArgs,
}

/// Energy and silhouette error of the fit of an outfit.
#[derive(Debug, Clone, Serialize)]
struct OutfitFit {
    outfit: Outfit,
    /// Energy of the whole fit, by the weights of the last stage.
    energy: f64,
    /// Silhouette term `E_S`, millimetres at the person's distance.
    silhouette_mm: f64,
    /// `None` without a mask.
    intersection_over_union: Option<f64>,
}

#[derive(Debug, Serialize)]
pub(super) struct Report {
    out: PathBuf,
    bare: BodyFit,
    pub(super) clothed: ClothedFit,
    /// Outfits that were fitted on all levels, lowest energy first.
    outfits: Vec<OutfitFit>,
    /// Remarks on what the fit does not rest on.
    notes: Vec<String>,
    pub(super) seconds: f64,
}

/// Camera, silhouette, keypoints and image.
pub(super) struct FitInput {
    pub(super) camera: PinholeCamera,
    pub(super) mask: Option<Mask>,
    pub(super) occluders: Option<Mask>,
    pub(super) keypoints: Keypoints,
    pub(super) image: Image,
    /// Remarks on how the files were read.
    pub(super) notes: Vec<String>,
}

/// Remark on a fit without a mask.
const NO_MASK: &str = "without --mask the silhouette term is left out: body and pose are those of the \
                       keypoints, and the clothing is hardly observed";

impl FitArgs {
    pub(crate) fn run(mut self, global: &GlobalArgs, console: Console) -> Result<ExitCode> {
        if self.file.is_none() && self.directory.is_none() {
            self.file = self.run.take_other();
            if self.file.is_none() {
                return Err(Error::message(
                    "KEYPOINTS: missing: name the file of 2D keypoints, or a directory of such files",
                ));
            }
        }
        if self.video.sequence() {
            video::run(&self, global, console)?;
            return Ok(ExitCode::SUCCESS);
        }
        if self.has_many_images() {
            return folder::run(&self, global, console);
        }
        self.output.require_empty()?;
        let config = self.config()?;
        let observed = self.read_input(self.keypoints(), &self.mask, self.image_id.clone())?;
        observed.notes.iter().for_each(|note| console.note(note));
        let run = self.run.open(global)?;
        let fitter = ImageFitter::new(&self, &run, config)?;
        let report = console.while_showing("fit", "stages", |progress| {
            fitter.fit(&observed, &fit_workers(&run)?, &self.output.out, progress)
        })?;
        report.write(&fitter, &observed)?;
        if let Some(better) = report.better_outfit() {
            console.note(&format!(
                "warning: {better} has a lower energy than {}",
                report.clothed.outfit
            ));
        }
        if let Some(problem) = report.problem() {
            return Err(Error::message(format!(
                "the fit in {} is unreliable: {problem}",
                report.out.display()
            )));
        }
        console.result(&report, || report.text())?;
        Ok(ExitCode::SUCCESS)
    }

    /// Keypoint file or directory.
    pub(super) fn keypoints(&self) -> &Path {
        self.file.as_deref().or(self.directory.as_deref()).unwrap_or(Path::new(""))
    }

    /// True if keypoints, masks or images are directories.
    fn has_many_images(&self) -> bool {
        let given = [Some(self.keypoints()), self.mask.mask.as_deref(), self.mask.image.as_deref()];
        given.into_iter().flatten().any(Path::is_dir)
    }

    /// Weights and stages.
    pub(super) fn config(&self) -> Result<FitConfig> {
        let mut config = self.method.config()?;
        if self.compare_outfits {
            config.clothed.finalists = usize::MAX;
        }
        Ok(config)
    }

    /// Reads the files of one image.
    pub(super) fn read_input(
        &self,
        file: &Path,
        mask: &MaskArgs,
        image: Option<String>,
    ) -> Result<FitInput> {
        let input = mask.read()?;
        let own = file.file_name().and_then(|name| name.to_str()).map(str::to_owned);
        let options = KeypointOptions {
            layout: self.layout,
            image,
            beside: mask.names().into_iter().chain(own).collect(),
            size: input.size,
        };
        let reading = || format!("reading {}", file.display());
        let people = read_keypoints_with(file, &options)?;
        let notes = [&input.notes, people.notes()].concat();
        let person = people.index(self.person, input.mask.as_ref()).doing(reading)?;
        let keypoints = people.person(person).doing(reading)?;
        let chosen = (&people, person, &keypoints);
        let PersonMask { mask: silhouette, occluders, size, image } =
            input.for_person(chosen, file, &options)?;
        let camera = PinholeCamera::new(size[0], size[1], self.focal)?;
        if let Some(silhouette) = &silhouette {
            silhouette
                .check(&camera)
                .and_then(|()| silhouette.check_keypoints(&keypoints, occluders.as_ref()))
                .doing(|| mask.reading())?;
        }
        let image = match image {
            Some(image) => image,
            None => drawing::paper(&camera)?,
        };
        Ok(FitInput { camera, mask: silhouette, occluders, keypoints, image, notes })
    }
}

impl FitInput {
    /// Observations of the person.
    pub(super) fn observation(&self) -> ImageObservation<'_> {
        let Self { camera, mask, occluders, keypoints, .. } = self;
        let (mask, occluders) = (mask.as_ref(), occluders.as_ref());
        ImageObservation { camera, keypoints, mask, occluders }
    }
}

/// Fits of a run's clothed bodies to images.
pub(super) struct ImageFitter<'a> {
    pub(super) run: &'a Run,
    pub(super) smplify: Smplify,
    pub(super) config: FitConfig,
    /// Bodies in the outfits that are fitted, the run's default first.
    pub(super) bodies: Vec<DressedBody>,
    /// Outfit of the command, if it names one.
    chosen: Option<Outfit>,
}

impl<'a> ImageFitter<'a> {
    pub(super) fn new(args: &FitArgs, run: &'a Run, config: FitConfig) -> Result<Self> {
        let smplify = args.method.smplify(run.body(), &config)?;
        let chosen = match (args.outfit, args.outfit.of(run)?.as_slice()) {
            (OutfitSelection::One(_), &[outfit]) => Some(outfit),
            _ => None,
        };
        let outfits = match chosen {
            Some(outfit) if !args.compare_outfits => vec![outfit],
            _ => {
                let default = run.default_outfit();
                let others = run.outfits().iter().copied().filter(|&outfit| outfit != default);
                [default].into_iter().chain(others).collect()
            }
        };
        let body = DressedBody::new(run, outfits[0])?;
        let bodies = outfits.iter().map(|&outfit| body.with_outfit(outfit));
        let bodies = bodies.collect::<Result<Vec<_>, _>>()?;
        Ok(Self { run, smplify, config, bodies, chosen })
    }

    /// Bodies in the outfits that `observed` can tell apart: without a mask, in the default one.
    pub(super) fn distinct(&self, silhouette: bool) -> &[DressedBody] {
        if silhouette { &self.bodies } else { &self.bodies[..1] }
    }

    /// Fits the body to an image, by SMPLify and with clothing.
    pub(super) fn fit(
        &self,
        observed: &FitInput,
        workers: &FitWorkers,
        out: &Path,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Report> {
        let start = Instant::now();
        let image = observed.observation();
        let bodies = self.distinct(observed.mask.is_some());
        let bare = self.smplify.fit(image.camera, image.keypoints, None)?;
        progress(1, 2 + bodies.len());
        let config = &self.config.clothed;
        let mut report = |done, all| progress(1 + done, 1 + all);
        let fits = self.smplify.fit_outfits(bodies, &image, &bare, config, workers, &mut report)?;
        let outfits = fits.iter().map(|fit| OutfitFit::from_fit(fit, config)).collect();
        let worn = |fit: &ClothedFit| self.chosen.is_none_or(|outfit| fit.outfit == outfit);
        let clothed = fits.into_iter().find(worn);
        let clothed = clothed.ok_or_else(|| Error::message("no outfit to fit"))?;
        let mut notes = Vec::new();
        if observed.mask.is_none() {
            notes.push(NO_MASK.to_owned());
            if self.chosen.is_none() {
                let outfit = clothed.outfit;
                notes.push(format!(
                    "nothing tells the outfits apart: {outfit} is taken; see --outfit"
                ));
            }
        }
        let seconds = start.elapsed().as_secs_f64();
        Ok(Report { bare, clothed, outfits, notes, seconds, out: out.to_owned() })
    }
}

impl OutfitFit {
    fn from_fit(fit: &ClothedFit, config: &ClothedConfig) -> Self {
        Self {
            outfit: fit.outfit,
            energy: fit.terms.weighted(config),
            silhouette_mm: 1000.0 * fit.terms.silhouette.total(),
            intersection_over_union: fit.intersection_over_union,
        }
    }
}

impl Report {
    /// Reason for which the fit is unreliable.
    pub(super) fn problem(&self) -> Option<&FitProblem> {
        self.bare.problem.as_ref().or(self.clothed.problem.as_ref())
    }

    fn better_outfit(&self) -> Option<Outfit> {
        let best = self.outfits.first()?.outfit;
        (best != self.clothed.outfit).then_some(best)
    }

    /// Writes all files, fit.json last. Returns the image with the fitted body over it.
    pub(super) fn write(&self, fitter: &ImageFitter<'_>, observed: &FitInput) -> Result<Image> {
        let run = fitter.run;
        files::create_dir(&self.out)?;
        let Self { bare, clothed, .. } = self;
        let at = |name: &str| self.out.join(name);
        let body = &bare.parameters;
        let posed = run.body().pose(&body.betas, &body.pose, body.transl, None)?;
        ply::write(at("bare.ply"), &run.body().mesh_with(&posed.vertices), None)?;

        let code = Array1::from_iter(clothed.code.iter().map(|&x| x as f32));
        let pose = Array1::from_iter(clothed.parameters.pose.iter().map(|&x| x as f32));
        write_npy(at("code.npy"), &code)?;
        write_npy(at("pose.npy"), &pose)?;
        let wearer = body_spec(clothed)?;
        let codes = code.insert_axis(ndarray::Axis(0));
        let dressed = dressed(run, &codes, &wearer)?;
        let worn = fitter.bodies.iter().find(|body| body.outfit() == clothed.outfit);
        let worn = worn.ok_or_else(|| Error::message("internal error: another outfit"))?;
        let surface = worn.surface(&clothed.parameters, &clothed.code)?;
        let mesh = drawing::mesh(surface.vertices(), &run.body().faces);
        ply::write(at("clothed.ply"), &mesh, Some(&dressed.colours_8_bit()))?;
        let performance = AnimatedBody {
            colours: Some(&dressed.colours),
            ..AnimatedBody::from_body("fitted", &codes, &wearer)
        };
        performance.save(run, at("clothed.glb"))?;
        let (overlay, fitted) = overlay(observed, &surface, run, &dressed)?;
        overlay.save(at("overlay.png"))?;
        drawing::energies(bare, clothed)?.save(at("energy.png"))?;
        write_json(&at("fit.json"), self)?;
        Ok(fitted)
    }

    fn text(&self) -> String {
        let silhouettes = match self.clothed.intersection_over_union {
            Some(overlap) => format!("silhouette IoU {:.1} %", 100.0 * overlap),
            None => "no silhouette".into(),
        };
        let line = format!(
            "{} in {:.1} s: {silhouettes}, mean joint error {:.1} pixels\n{}",
            self.clothed.outfit,
            self.seconds,
            self.clothed.joint_error,
            self.out.join("overlay.png").display()
        );
        let line = [vec![line], self.notes.clone()].concat().join("\n");
        if self.outfits.len() == 1 {
            return line;
        }
        let mut table = Table::new(["outfit", "energy", "silhouette, mm", "IoU"]);
        for OutfitFit { outfit, energy, silhouette_mm, intersection_over_union } in &self.outfits {
            table.row([
                outfit.to_string(),
                format!("{energy:.1}"),
                format!("{silhouette_mm:.2}"),
                intersection_over_union
                    .map_or_else(String::new, |iou| format!("{:.1} %", 100.0 * iou)),
            ]);
        }
        format!("{}\n\n{line}", table.text())
    }
}

/// One worker for each thread on the CPU; other devices work on one fit at a time.
pub(super) fn fit_workers(run: &Run) -> Result<FitWorkers> {
    if cape_core::is_cpu(run.device()) {
        Ok(FitWorkers::new()?)
    } else {
        Ok(FitWorkers::sequential())
    }
}

/// The fitted body.
fn body_spec(clothed: &ClothedFit) -> Result<BodySpec> {
    let pose: Vec<f32> = clothed.parameters.pose.iter().map(|&x| x as f32).collect();
    let numbers = pose.len();
    let pose = pose.try_into();
    let pose =
        pose.map_err(|_| Error::message(format!("internal error: a pose of {numbers} values")))?;
    let betas = clothed.parameters.betas.iter().map(|&x| x as f32).collect();
    Ok(BodySpec { betas, pose, outfit: clothed.outfit })
}

pub(super) fn dressed(run: &Run, codes: &Array2<f32>, wearer: &BodySpec) -> Result<DressedMesh> {
    let wearers = std::slice::from_ref(wearer);
    let mut bodies = DressedRenderer::new(run)
        .pose_clothed(&run.decode_displacements(codes, wearers)?, wearers)?;
    bodies.pop().ok_or_else(|| Error::message("internal error: no mesh was produced"))
}

/// The image with its keypoints, the difference of the silhouettes, and the fitted body over it; and the
/// last of them alone.
fn overlay(
    observed: &FitInput,
    surface: &DressedSurface,
    run: &Run,
    dressed: &DressedMesh,
) -> Result<(Image, Image)> {
    let FitInput { camera, mask, occluders, keypoints, image, notes: _ } = observed;
    let vertices: &[DVec3] = surface.vertices();
    let faces = &run.body().faces;
    let mut seen = image.clone();
    drawing::mark(&mut seen, keypoints);
    let mut tiles = vec![(seen, "keypoints")];
    if let Some(mask) = mask {
        let mut silhouettes = image.clone();
        drawing::difference(&mut silhouettes, mask, render(vertices, faces, camera)?.mask());
        let label = match occluders {
            Some(occluders) => {
                drawing::hide(&mut silhouettes, occluders);
                "red: mask, blue: fit, grey: occluders"
            }
            None => "red: mask, blue: fit",
        };
        tiles.push((silhouettes, label));
    }
    let mut fitted = image.clone();
    drawing::body(&mut fitted, vertices, faces, Some(&dressed.colours), camera)?;
    tiles.push((fitted.clone(), "fit"));
    let tiles: Vec<Tile> =
        tiles.into_iter().map(|(image, label)| Tile { image, label: label.into() }).collect();
    Ok((contact_sheet(&tiles, tiles.len(), None)?, fitted))
}
