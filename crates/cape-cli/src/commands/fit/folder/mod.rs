//! Fits to all images of a directory, side by side and resumable.

mod items;

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use cape_core::Outfit;
use cape_eval::store::{ResultStore, StoreOptions, StoreSettings, sha256};
use cape_render::{Image, Tile, contact_sheet};
use serde::{Deserialize, Serialize};
use serde_json::json;

pub(super) use items::{ImageItem, ImageSources};

use super::{
    drawing,
    image::{FitArgs, FitInput, ImageFitter, fit_workers},
};
use crate::{
    console::{Console, seconds},
    error::{Error, Result, in_one_line},
    exit_code::ExitCode,
    files,
    interrupt::Interrupt,
    options::GlobalArgs,
};

/// Longer side of a picture of the contact sheet, pixels.
const THUMBNAIL: u32 = 240;
/// Largest number of pictures of the contact sheet, and its columns.
const THUMBNAILS: usize = 60;
const COLUMNS: usize = 6;

/// Result of one image, a line of fits.jsonl.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct ImageFit {
    image: String,
    status: Status,
    /// Reason for which the image was not fitted, or the fit is unreliable.
    reason: Option<String>,
    /// Directory with the fit, relative to --out.
    directory: Option<String>,
    outfit: Option<Outfit>,
    intersection_over_union: Option<f64>,
    /// Mean distance of the projected joints from their detections, pixels.
    joint_error: Option<f64>,
    seconds: f64,
    notes: Vec<String>,
    /// SHA-256 of the files of the image.
    inputs: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Status {
    Reliable,
    Unreliable,
    Failed,
}

#[derive(Debug, Serialize)]
struct Summary {
    out: PathBuf,
    images: usize,
    reliable: usize,
    unreliable: usize,
    failed: usize,
    /// Duration of this command, seconds.
    seconds: f64,
}

pub(super) fn run(args: &FitArgs, global: &GlobalArgs, console: Console) -> Result<ExitCode> {
    if args.image_id.is_some() {
        return Err(Error::message(
            "--image-id: names one image, but there are directories: images are found by file name",
        ));
    }
    let items = args.sources().items()?;
    let config = args.config()?;
    let run = args.run.open(global)?;
    let settings = json!({
        "config": config,
        "outfit": args.outfit.name(),
        "layout": args.layout.map(|layout| layout.to_string()),
        "person": args.person,
        "focal": args.focal,
        "labels": args.mask.label_names(),
        "image_size": args.mask.size(),
    });
    let settings =
        StoreSettings::new("fit image", &settings)?.with_run(&run)?.with_optional_input(
            "pose_prior",
            args.method.pose_prior.as_deref(),
            "synthetic motions",
        )?;
    let store = ResultStore::open(&args.output.out, settings, StoreOptions::default())?;
    let _lock = store.lock()?;
    store.begin()?;
    let interrupt = Interrupt::listen(console)?;
    let fitter = ImageFitter::new(args, &run, config)?;
    let workers = fit_workers(&run)?;
    let start = Instant::now();
    let mut done = 0;
    let fits = console.while_showing("fit", "images", |progress| {
        let fit = |_, item: &ImageItem| {
            if interrupt.was_asked() {
                return Ok(None);
            }
            fit_item(args, &fitter, &store, item).map(Some)
        };
        workers.map(&items, fit, &mut || {
            done += 1;
            progress(done, items.len());
        })
    });
    let fits = fits.into_iter().collect::<Result<Option<Vec<ImageFit>>>>()?;
    let Some(fits) = fits else {
        console.note("interrupted and saved: run the same command again to resume");
        return Ok(ExitCode::INTERRUPTED);
    };
    files::write_json_lines(&store.claim("fits.jsonl")?, &fits)?;
    let pictures: Vec<(&ImageFit, PathBuf)> = fits
        .iter()
        .filter_map(|fit| Some((fit, store.path(fit.directory.as_ref()?).join("thumbnail.png"))))
        .collect();
    let tiles = chosen(&pictures).map(|(fit, path)| fit.tile(path)).collect::<Result<Vec<_>>>()?;
    if !tiles.is_empty() {
        sheet(&tiles)?.save(store.claim("fits.png")?)?;
    }
    let count = |status: Status| fits.iter().filter(|fit| fit.status == status).count();
    let summary = Summary {
        out: args.output.out.clone(),
        images: fits.len(),
        reliable: count(Status::Reliable),
        unreliable: count(Status::Unreliable),
        failed: count(Status::Failed),
        seconds: start.elapsed().as_secs_f64(),
    };
    for fit in fits.iter().filter(|fit| fit.status == Status::Failed) {
        console.note(&format!("{}: {}", fit.image, fit.reason.as_deref().unwrap_or("failed")));
    }
    if summary.failed == summary.images {
        return Err(Error::message("no image could be fitted"));
    }
    console.result(&summary, || summary.text())?;
    Ok(ExitCode::SUCCESS)
}

/// Pictures for the contact sheet, evenly spread if there are many.
pub(super) fn chosen<T>(pictures: &[T]) -> impl Iterator<Item = &T> {
    let count = pictures.len().min(THUMBNAILS);
    (0..count).map(move |at| &pictures[at * pictures.len() / count])
}

/// The stored fit of an image, or a new one. Errors are of the output; those of the image are in the
/// result.
fn fit_item(
    args: &FitArgs,
    fitter: &ImageFitter<'_>,
    store: &ResultStore,
    item: &ImageItem,
) -> Result<ImageFit> {
    let record = format!("images/{}.json", item.name);
    let inputs = item.sha256();
    if let Some(fit) = store.read::<ImageFit>(&record)?
        && fit.inputs == inputs
    {
        return Ok(fit);
    }
    let start = Instant::now();
    let directory = format!("{}/", item.name);
    store.discard(&directory)?;
    let failed = |reason: String, start: Instant| ImageFit {
        image: item.name.clone(),
        status: Status::Failed,
        reason: Some(reason),
        directory: None,
        outfit: None,
        intersection_over_union: None,
        joint_error: None,
        seconds: start.elapsed().as_secs_f64(),
        notes: Vec::new(),
        inputs: inputs.clone(),
    };
    let workers = fit_workers(fitter.run)?;
    let found = item.read(args).and_then(|observed| {
        let out = store.path(&item.name);
        let report = fitter.fit(&observed, &workers, &out, &mut |_, _| {})?;
        Ok((observed, report))
    });
    let fit = match found {
        Err(error) => failed(in_one_line(&error), start),
        Ok((observed, report)) => {
            let out = store.claim(&directory)?;
            let picture = report.write(fitter, &observed)?;
            thumbnail(&picture, &observed)?.save(out.join("thumbnail.png"))?;
            let problem = report.problem();
            ImageFit {
                status: if problem.is_some() { Status::Unreliable } else { Status::Reliable },
                reason: problem.map(ToString::to_string),
                directory: Some(item.name.clone()),
                outfit: Some(report.clothed.outfit),
                intersection_over_union: report.clothed.intersection_over_union,
                joint_error: Some(report.clothed.joint_error),
                seconds: report.seconds,
                notes: observed.notes,
                ..failed(String::new(), start)
            }
        }
    };
    Ok(store.write(&record, &fit)?)
}

/// The person in a picture, small.
pub(super) fn thumbnail(picture: &Image, observed: &FitInput) -> Result<Image> {
    let mask = observed.mask.as_slice();
    let part = match drawing::person_box(mask) {
        Some(person) => drawing::cut(picture, person)?,
        None => picture.clone(),
    };
    Ok(part.reduced(THUMBNAIL)?)
}

/// Contact sheet of small pictures.
pub(super) fn sheet(tiles: &[Tile]) -> Result<Image> {
    Ok(contact_sheet(tiles, COLUMNS.min(tiles.len()), None)?)
}

impl FitArgs {
    /// Keypoints, masks and images.
    pub(super) fn sources(&self) -> ImageSources<'_> {
        ImageSources {
            keypoints: self.keypoints(),
            masks: self.mask.mask.as_deref(),
            images: self.mask.image.as_deref(),
        }
    }
}

impl ImageItem {
    /// Reads the files of the image.
    pub(super) fn read(&self, args: &FitArgs) -> Result<FitInput> {
        let mask = self.mask.clone().map_err(Error::message)?;
        let mask = args.mask.with_files(mask, self.image.clone());
        let several = (!args.keypoints().is_dir()).then(|| self.name.clone());
        args.read_input(&self.keypoints, &mask, several)
    }

    /// SHA-256 of each file, or the reason why it cannot be read.
    fn sha256(&self) -> String {
        let mask = self.mask.iter().flatten();
        let paths = [&self.keypoints].into_iter().chain(mask).chain(&self.image);
        let digest = |path: &PathBuf| sha256(path).unwrap_or_else(|error| error.to_string());
        paths.map(digest).collect::<Vec<_>>().join(" ")
    }
}

impl ImageFit {
    fn tile(&self, picture: &Path) -> Result<Tile> {
        let quality = match (self.status, self.intersection_over_union) {
            (Status::Reliable, Some(overlap)) => format!(" {:.0} %", 100.0 * overlap),
            (Status::Reliable, None) => String::new(),
            _ => " unreliable".into(),
        };
        Ok(Tile { image: Image::load(picture)?, label: self.image.clone() + &quality })
    }
}

impl Summary {
    fn text(&self) -> String {
        let out = self.out.display();
        format!(
            "{} images in {}: {} reliable, {} unreliable, {} failed\n{out}/fits.jsonl\n{out}/fits.png",
            self.images,
            seconds(self.seconds),
            self.reliable,
            self.unreliable,
            self.failed
        )
    }
}
