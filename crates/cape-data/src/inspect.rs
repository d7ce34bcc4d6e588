//! Inspection of data sets: counts, magnitudes and common mistakes.

mod download;

pub use download::PresetCompleteness;

use std::{
    collections::{BTreeMap, BTreeSet, btree_map::Entry},
    path::{Path, PathBuf},
};

use cape_core::{
    Outfit, SmplModel,
    joints::{JOINTS, pose_rotations},
    smpl::{ClothingMask, Gender},
};
use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use serde::Serialize;

use super::{
    ForeignData, FrameSource, PackedSet, RawTree, Split,
    raw::{BODY_FILE, CLOTHING_FILE},
};
use crate::{Error, Result};
use cape_core::ProgressFn;

/// Options of [`inspect`](inspect()).
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_core::silent;
/// use cape_data::inspect::{InspectOptions, inspect};
///
/// let directory = captures()?;
/// let options = InspectOptions { frames: 2, ..InspectOptions::default() };
/// let found = inspect(&directory.path().join("packed"), &options, &mut silent)?;
/// assert_eq!((found.kind, found.frames, found.vertices), ("packed", 8, 6890));
/// assert_eq!(found.captures.iter().map(|capture| capture.frames).sum::<usize>(), 8);
/// // Displacements are larger at clothing vertices than on bare skin.
/// assert!(found.clothing_mm.unwrap().mean > found.elsewhere_mm.unwrap().mean);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, Default)]
pub struct InspectOptions {
    /// Number of frames examined per capture, evenly spaced.
    pub frames: usize,
    /// File of the indices of clothing vertices; `None` uses that of the data.
    pub clothing: Option<PathBuf>,
    /// Body from whose blend weights clothing vertices are derived if there are no indices; `None`
    /// uses that of the data, by the gender of the subject.
    pub body: Option<SmplModel>,
    /// Preset, `male` or `female`, whose frames a raw data set is compared with.
    pub preset: Option<String>,
}

/// Report of [`inspect`](inspect()).
#[derive(Debug, Clone, Default, Serialize)]
pub struct Inspection {
    /// Layout of the data: `raw` or `packed`.
    pub kind: &'static str,
    /// Numbers of frames by subject, outfit and sequence.
    pub captures: Vec<CaptureCount>,
    /// Number of frames.
    pub frames: usize,
    /// Number of frames examined.
    pub examined: usize,
    /// Number of vertices of a frame.
    pub vertices: usize,
    /// Heights of the shortest and the tallest subject, metres.
    pub height_m: Option<[f64; 2]>,
    /// Displacements at clothing vertices, millimetres.
    pub clothing_mm: Option<Magnitudes>,
    /// Displacements at head, hands and feet, millimetres.
    pub elsewhere_mm: Option<Magnitudes>,
    /// Displacements at all vertices, millimetres.
    pub displacement_mm: Option<Magnitudes>,
    /// Largest rotation angle of a joint other than the root, radians.
    pub largest_rotation: Option<f64>,
    /// Largest length of a translation, metres.
    pub largest_translation_m: Option<f64>,
    /// What the release's lists say of a raw data set, in sentences.
    pub release: Vec<String>,
    /// Comparison with a preset, if asked for.
    pub preset: Option<PresetCompleteness>,
    /// Probable mistakes, with a remedy.
    pub warnings: Vec<String>,
}

/// Number of frames of a capture, or of all captures of an outfit if the origins are unknown.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct CaptureCount {
    /// Part of a packed set.
    pub part: Option<Split>,
    /// Subject, if known.
    pub subject: Option<String>,
    /// Outfit.
    pub outfit: Option<Outfit>,
    /// Motion sequence, if known.
    pub sequence: Option<String>,
    /// Number of frames.
    pub frames: usize,
}

/// Mean and maximum of the lengths of displacements, millimetres.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Magnitudes {
    /// Mean length.
    pub mean: f64,
    /// Largest length.
    pub max: f64,
}

/// Sum, count and maximum of lengths, metres.
#[derive(Debug, Clone, Copy, Default)]
struct LengthTotals {
    sum: f64,
    count: usize,
    max: f64,
}

impl LengthTotals {
    fn push(&mut self, length: f64) {
        self.sum += length;
        self.count += 1;
        self.max = self.max.max(length);
    }

    fn millimetres(self) -> Option<Magnitudes> {
        let mean = 1000.0 * self.sum / self.count.max(1) as f64;
        (self.count > 0).then_some(Magnitudes { mean, max: 1000.0 * self.max })
    }
}

/// Totals over the examined frames.
#[derive(Debug, Default)]
struct InspectionTotals {
    clothing: LengthTotals,
    elsewhere: LengthTotals,
    all: LengthTotals,
    rotation: Option<f64>,
    translation: Option<f64>,
}

impl InspectionTotals {
    fn displacement(&mut self, displacement: ArrayView2<f64>, mask: Option<&ClothingMask>) {
        for (vertex, row) in displacement.rows().into_iter().enumerate() {
            let length = row.dot(&row).sqrt();
            self.all.push(length);
            match mask.and_then(|mask| mask.covered().get(vertex)) {
                Some(true) => self.clothing.push(length),
                Some(false) => self.elsewhere.push(length),
                None => {}
            }
        }
    }

    fn pose(&mut self, pose: &[f64]) {
        for axis_angle in pose.chunks_exact(3).skip(1) {
            let angle = axis_angle.iter().map(|x| x * x).sum::<f64>().sqrt();
            self.rotation = Some(self.rotation.map_or(angle, |most| most.max(angle)));
        }
    }
}

/// Inspects a raw tree or a packed set.
///
/// # Errors
/// If `path` is neither, or a file other than the frames is invalid. Unreadable frames give a
/// warning.
pub fn inspect(
    path: impl AsRef<Path>,
    options: &InspectOptions,
    progress: &mut ProgressFn,
) -> Result<Inspection> {
    let path = path.as_ref();
    let parts = [Split::Train, Split::Test].map(|part| (part, part.path(path, "disp")));
    if parts.iter().any(|(_, file)| file.exists()) {
        return inspect_packed(path, options, progress);
    }
    if RawTree::is_raw(path) {
        return inspect_raw(path, options, progress);
    }
    if let Some(data) = ForeignData::recognise(path) {
        return Err(Error::Data(format!("{}: {data}", path.display())));
    }
    Err(Error::Data(format!(
        "{}: neither raw data (no sequences/ or cape_release/) nor a packed set (no train/train_disp.npy)",
        path.display()
    )))
}

/// Clothing vertices of the data in `path` and of the body in `own`, if they are known.
fn mask(
    path: &Path,
    own: Option<&Path>,
    options: &InspectOptions,
    vertices: usize,
) -> Result<Option<ClothingMask>> {
    let indices = path.join(CLOTHING_FILE);
    if let Some(file) = options.clothing.as_ref().or(indices.is_file().then_some(&indices)) {
        return Ok(Some(ClothingMask::load(file, vertices)?));
    }
    let differs = |body: &SmplModel| {
        let message = format!("{} vertices, but the data have {vertices}", body.vertices());
        (body.vertices() != vertices).then_some(message)
    };
    let body = match (&options.body, own) {
        (Some(body), _) => match differs(body) {
            Some(message) => return Err(Error::argument(format!("the given body has {message}"))),
            None => body.clone(),
        },
        (None, Some(file)) => {
            let body = SmplModel::load(file)?;
            match differs(&body) {
                Some(message) => return Err(Error::field(file, "v_template", message)),
                None => body,
            }
        }
        (None, None) => return Ok(None),
    };
    Ok(Some(ClothingMask::from_weights(&body)?))
}

fn inspect_raw(
    root: &Path,
    options: &InspectOptions,
    progress: &mut ProgressFn,
) -> Result<Inspection> {
    let mut found = Inspection { kind: "raw", ..Inspection::default() };
    let tree = RawTree::open(root)?;
    let mut minimal = BTreeMap::new();
    let mut samples: Vec<(&str, &FrameSource)> = Vec::new();
    for subject in tree.subjects() {
        match tree.minimal(subject, false) {
            Ok(shape) => drop(minimal.insert(subject.to_owned(), shape)),
            Err(error) => found.warnings.push(format!("{subject}: no minimal shape: {error}")),
        }
        for title in tree.other_entries(subject) {
            found.warnings.push(format!(
                "{subject}/{title}: ignored, expected a directory named outfit_sequence"
            ));
        }
        for capture in tree.captures(subject) {
            let (title, frames) = (capture.name(), capture.frames());
            if frames.len() <= 4 {
                found.warnings.push(format!(
                    "{subject}/{title}: {} frames, none is left after cutting 2 at either end",
                    frames.len()
                ));
            }
            found.captures.push(CaptureCount {
                part: None,
                subject: Some(subject.to_owned()),
                outfit: Some(capture.outfit()),
                sequence: Some(capture.sequence().to_owned()),
                frames: frames.len(),
            });
            let picked = spread(frames.len(), options.frames);
            samples.extend(picked.map(|at| (subject, &frames[at])));
        }
    }
    found.release = download::examine(&tree)?;
    found.warnings.extend(tree.notes().iter().cloned());
    if let Some(preset) = &options.preset {
        found.preset = Some(download::completeness(&tree, preset)?);
    }
    found.frames = found.captures.iter().map(|capture| capture.frames).sum();
    let counts: BTreeSet<usize> = minimal.values().map(Array2::nrows).collect();
    if counts.len() > 1 {
        found.warnings.push(format!("minimal shapes differ in the number of vertices: {counts:?}"));
    }
    found.vertices = counts.first().copied().unwrap_or(0);
    heights(&minimal, &mut found);

    let genders = tree.genders()?;
    let gender = |subject: &str| genders.get(subject).and_then(|gender| gender.parse().ok());
    let mut masks: BTreeMap<Option<Gender>, Option<ClothingMask>> = BTreeMap::new();
    for subject in tree.subjects().filter(|_| found.vertices > 0) {
        if let Entry::Vacant(place) = masks.entry(gender(subject)) {
            let body = tree.body_path(*place.key());
            place.insert(mask(root, body.as_deref(), options, found.vertices)?);
        }
    }
    let mut tally = InspectionTotals::default();
    let mut unreadable = Vec::new();
    let mut posed_as_canonical = 0;
    let total = samples.len();
    for chunk in samples.chunks(4 * rayon::current_num_threads()) {
        let read: Vec<Result<_>> = chunk.par_iter().map(|(_, source)| source.any()).collect();
        for ((subject, source), frame) in chunk.iter().zip(read) {
            let (frame, posed) = match frame {
                Ok(read) => read,
                Err(error) => {
                    unreadable.push(error.to_string());
                    continue;
                }
            };
            found.examined += 1;
            tally.pose(&frame.pose);
            if let Some((v_posed, transl)) = &posed {
                let distance = transl.iter().map(|x| x * x).sum::<f64>().sqrt();
                tally.translation = Some(tally.translation.map_or(distance, |d| d.max(distance)));
                posed_as_canonical += usize::from(frame.v_cano == *v_posed);
            }
            match minimal.get(*subject) {
                Some(shape) if shape.dim() == frame.v_cano.dim() => {
                    let mask = masks.get(&gender(subject)).and_then(Option::as_ref);
                    tally.displacement((&frame.v_cano - shape).view(), mask);
                }
                Some(shape) => unreadable.push(format!(
                    "{}: {} vertices, but the minimal shape has {}",
                    source.path().display(),
                    frame.v_cano.nrows(),
                    shape.nrows()
                )),
                None => {}
            }
        }
        progress(found.examined + unreadable.len(), total);
    }
    if let Some(first) = unreadable.first() {
        found.warnings.push(format!(
            "{} of {total} examined frames cannot be used; the first: {first}",
            unreadable.len()
        ));
    }
    if found.examined > 0 && posed_as_canonical == found.examined {
        found.warnings.push(
            "v_cano equals v_posed in all frames: unpose the meshes first (cape data unpose)"
                .into(),
        );
    }
    conclude(&mut found, &tally, masks.values().any(Option::is_some));
    Ok(found)
}

fn inspect_packed(
    root: &Path,
    options: &InspectOptions,
    progress: &mut ProgressFn,
) -> Result<Inspection> {
    let mut found = Inspection { kind: "packed", ..Inspection::default() };
    let mut tally = InspectionTotals::default();
    let mut sequences: BTreeMap<Split, BTreeSet<(String, Outfit, String)>> = BTreeMap::new();
    let mut masked = false;
    let mut inconsistent = 0;
    for part in [Split::Train, Split::Test] {
        if !part.path(root, "disp").exists() {
            found.warnings.push(format!("no {part} part"));
            continue;
        }
        let set = PackedSet::open(root, part)?;
        if found.vertices != 0 && found.vertices != set.vertices() {
            found.warnings.push(format!(
                "training frames have {} vertices, test frames {}",
                found.vertices,
                set.vertices()
            ));
        }
        if part == Split::Train && !set.names_outfits() && !set.vocabulary().is_paper() {
            found.warnings.push(format!(
                "labels of {} outfits without names: name them in split.toml or, for training, as \
                 `outfits` of `[model]`",
                set.vocabulary().len()
            ));
        }
        if set.origins().is_none() {
            found.warnings.push(format!(
                "the captures of the {part} frames are unknown (no {part}_frames.csv): evaluation has no \
                 confidence intervals, p-values and errors by sequence"
            ));
        }
        found.vertices = set.vertices();
        found.frames += set.frames();
        let mut counts: Vec<CaptureCount> = Vec::new();
        for (frame, &outfit) in set.outfits().iter().enumerate() {
            let origin = set.origins().map(|origins| &origins[frame]);
            let subject = origin.map(|origin| origin.subject.clone());
            let sequence = origin.map(|origin| origin.sequence.clone());
            if let (Some(subject), Some(sequence)) = (&subject, &sequence) {
                let capture = (subject.clone(), outfit, sequence.clone());
                sequences.entry(part).or_default().insert(capture);
            }
            let capture = CaptureCount {
                part: Some(part),
                subject,
                outfit: Some(outfit),
                sequence,
                frames: 0,
            };
            let known = counts
                .iter_mut()
                .rev()
                .find(|count| CaptureCount { frames: 0, ..(*count).clone() } == capture);
            match known {
                Some(count) => count.frames += 1,
                None => counts.push(CaptureCount { frames: 1, ..capture }),
            }
        }
        let own = Some(root.join(BODY_FILE)).filter(|path| path.is_file());
        let mask = mask(root, own.as_deref(), options, set.vertices())?;
        masked |= mask.is_some();
        let wanted = options.frames.saturating_mul(counts.len());
        found.captures.extend(counts);
        for (done, frame) in spread(set.frames(), wanted).enumerate() {
            let (displacement, pose, rotations) = set.frame(frame)?;
            tally.displacement(displacement.view(), mask.as_ref());
            tally.pose(&pose);
            let expected = pose_rotations(&pose)?;
            let differs = |(a, b): (&f64, &f64)| (a - b).abs() > 1e-4;
            let expected = expected.as_flattened().as_flattened();
            inconsistent += usize::from(rotations.iter().zip(expected).any(differs));
            found.examined += 1;
            progress(done + 1, wanted.min(set.frames()));
        }
    }
    if inconsistent > 0 {
        found.warnings.push(format!(
            "in {inconsistent} of {} examined frames the rotation matrices are not those of the pose",
            found.examined
        ));
    }
    if let (Some(train), Some(test)) = (sequences.get(&Split::Train), sequences.get(&Split::Test))
        && let Some((subject, outfit, sequence)) = train.intersection(test).next()
    {
        found.warnings.push(format!(
            "{subject}/{outfit}_{sequence} is in both parts: test errors would be too low"
        ));
    }
    conclude(&mut found, &tally, masked);
    Ok(found)
}

/// Records the heights of the minimal shapes; warns about wrong units and axes.
fn heights(minimal: &BTreeMap<String, Array2<f64>>, found: &mut Inspection) {
    let mut range: Option<[f64; 2]> = None;
    for (subject, shape) in minimal {
        let extent = [0, 1, 2].map(|axis| {
            let column = shape.column(axis);
            let low = column.iter().copied().fold(f64::INFINITY, f64::min);
            let high = column.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            high - low
        });
        let tall = extent[1];
        range = Some(range.map_or([tall; 2], |[low, high]| [low.min(tall), high.max(tall)]));
        let largest = extent.into_iter().fold(0.0, f64::max);
        let unit = match largest {
            500.0..=3500.0 => Some("millimetres: divide by 1000"),
            50.0..=350.0 => Some("centimetres: divide by 100"),
            0.5..=3.5 => None,
            _ => Some("unknown"),
        };
        if let Some(unit) = unit {
            found.warnings.push(format!(
                "{subject}: the minimal shape has an extent of {largest:.1}; its unit seems to be {unit} \
                 (expected metres)"
            ));
        } else if extent[2] > extent[1] {
            found.warnings.push(format!(
                "{subject}: the minimal shape is longer along z than along y (expected SMPL's axes: y \
                 up, z to the front)"
            ));
        }
    }
    found.height_m = range;
}

/// Copies the totals into the report and adds warnings about implausible values.
fn conclude(found: &mut Inspection, tally: &InspectionTotals, masked: bool) {
    found.displacement_mm = tally.all.millimetres();
    found.clothing_mm = tally.clothing.millimetres();
    found.elsewhere_mm = tally.elsewhere.millimetres();
    found.largest_rotation = tally.rotation;
    found.largest_translation_m = tally.translation;
    let warnings = &mut found.warnings;
    if found.frames == 0 {
        warnings.push("no frames".into());
    }
    if let Some(worn) = found.clothing_mm.or(found.displacement_mm) {
        if worn.mean > 1e4 {
            warnings.push(format!(
                "mean displacement of {:.0} mm: v_cano and the minimal shape seem to have different \
                 units (expected metres)",
                worn.mean
            ));
        } else if worn.mean > 100.0 {
            warnings.push(format!(
                "mean displacement of {:.0} mm is too large for clothing: v_cano is posed, shifted, or \
                 of another subject (expected the unposed mesh on its minimal shape)",
                worn.mean
            ));
        } else if worn.mean < 0.1 {
            warnings.push(format!(
                "mean displacement of {:.3} mm: no clothing (expected registrations of clothed people)",
                worn.mean
            ));
        }
    }
    if let (Some(worn), Some(bare)) = (found.clothing_mm, found.elsewhere_mm)
        && bare.mean > 10.0
        && bare.mean > 0.5 * worn.mean
    {
        warnings.push(format!(
            "mean displacement of head, hands and feet is {:.1} mm, that of clothing {:.1} mm: \
             registrations are not aligned with the minimal shape, or include hair and shoes",
            bare.mean, worn.mean
        ));
    }
    if !masked {
        warnings.push(
            "clothing vertices are unknown: give --clothing or --body to measure them apart".into(),
        );
    }
    match found.largest_rotation {
        Some(angle) if angle > 2.5 * std::f64::consts::PI => warnings.push(format!(
            "rotation of a joint by {angle:.1}: poses seem to be in degrees (expected radians)"
        )),
        Some(0.0) => warnings.push(format!("all rotations of the {JOINTS} joints are zero")),
        _ => {}
    }
    let outfits: BTreeSet<Outfit> = found.captures.iter().filter_map(|c| c.outfit).collect();
    if found.frames > 0 && outfits.len() == 1 {
        warnings.push("only one outfit: a model cannot learn the outfit condition".into());
    }
}

/// `wanted` of `count` indices, evenly spaced.
fn spread(count: usize, wanted: usize) -> impl Iterator<Item = usize> {
    let wanted = wanted.min(count);
    (0..wanted).map(move |k| (2 * k + 1) * count / (2 * wanted))
}

#[cfg(test)]
#[path = "inspect_tests.rs"]
mod tests;
