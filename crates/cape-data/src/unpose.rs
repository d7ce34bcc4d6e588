//! Unposing of posed registrations into raw frames for [`pack`](super::pack()).

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use cape_core::{
    SmplModel,
    npy::write_npy,
    smpl::{GENDERS_FILE, SubjectBodies, write_genders},
};
use ndarray::Array2;
use rayon::prelude::*;
use serde::Serialize;

use super::{
    FrameSource, RawCapture, RawTree,
    raw::{self, RawFrame},
};
use crate::{Error, Result};
use cape_core::ProgressFn;
use cape_core::StagingDirectory;

/// Report of [`unpose`].
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_synth::synthetic_body;
/// use cape_core::silent;
/// use cape_data::unpose::unpose;
///
/// // Four frames each of two motions of a synthetic subject.
/// let directory = captures()?;
/// let [raw, unposed] = ["raw", "unposed"].map(|name| directory.path().join(name));
/// let report = unpose(&raw, &unposed, &synthetic_body(), 10, &mut silent)?;
/// assert_eq!((report.frames, report.broken.len()), (8, 0));
/// // The subject is a shape of the body model; clothing is some millimetres off it.
/// assert!(report.subjects[0].residual_mm < 0.01);
/// assert!((1.0..50.0).contains(&report.displacement_mm));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct UnposeReport {
    /// Subjects, in the order of their names.
    pub subjects: Vec<UnposedSubject>,
    /// Number of frames written.
    pub frames: usize,
    /// Mean length of the displacements, millimetres; typically 5 to 20 for clothing.
    pub displacement_mm: f64,
    /// Frames left out, with the reason.
    pub broken: Vec<(PathBuf, String)>,
}

/// A subject and the fit of the body model to its minimal shape.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UnposedSubject {
    /// Name of the subject.
    pub subject: String,
    /// Number of frames written.
    pub frames: usize,
    /// Shape coefficients β of the body nearest to the minimal shape.
    pub betas: Vec<f64>,
    /// Root mean square vertex distance of that body from the minimal shape, millimetres.
    pub residual_mm: f64,
}

/// Unposes every frame of the raw tree `raw`: reads `v_posed`, `pose` and `transl` (zero if
/// missing), and writes them with `v_cano` into the new tree `out`, which appears only when it is
/// complete. Joint positions come from the minimal shape of the subject; `betas` is the number of
/// shape coefficients fitted to it. Of bodies by gender, each subject has that of its gender by
/// `misc/subj_genders.pkl`.
///
/// # Errors
/// If a minimal shape is missing or does not match the body, a gender that is needed is unknown, or no
/// frame is left. Frames that cannot be read or unposed are listed in the report.
pub fn unpose<'a>(
    raw: impl AsRef<Path>,
    out: impl AsRef<Path>,
    bodies: impl Into<SubjectBodies<'a>>,
    betas: usize,
    progress: &mut ProgressFn,
) -> Result<UnposeReport> {
    let (raw, out, bodies) = (raw.as_ref(), out.as_ref(), bodies.into());
    let mut report = UnposeReport::default();
    let staging = StagingDirectory::create(out)?;
    let tree = RawTree::open(raw)?;
    let subjects = plan(&tree);
    let total = subjects.iter().map(|(_, frames)| frames.len()).sum();
    let (mut done, mut sum) = (0, 0.0);
    let known = tree.genders()?;
    let (mut genders, mut used) = (BTreeMap::new(), BTreeMap::new());
    for (subject, frames) in &subjects {
        let gender = known.get(*subject).and_then(|gender| gender.parse().ok());
        let body = bodies
            .of(gender)
            .map_err(|error| Error::Data(format!("{subject}: {error}, in {GENDERS_FILE}")))?;
        used.insert(bodies.file_name(gender), body);
        genders.extend(gender.map(|gender| ((*subject).to_owned(), gender)));
        let minimal = tree.minimal(subject, false)?;
        let fit = body
            .fit_betas(&minimal, betas)
            .map_err(|error| Error::format(tree.minimal_path(subject), error.to_string()))?;
        raw::write_minimal(&staging.path, subject, &minimal)?;
        let mut written = 0;
        for chunk in frames.chunks(4 * rayon::current_num_threads()) {
            let unposed: Vec<Result<f64>> = chunk
                .par_iter()
                .map(|source| {
                    source.require_inside()?;
                    let (frame, length) = unpose_frame(source, &minimal, body)?;
                    let place = staging.path.join("sequences").join(source.relative());
                    raw::write_frame_at(&place, &frame)?;
                    Ok(length)
                })
                .collect();
            for (source, unposed) in chunk.iter().zip(unposed) {
                match unposed {
                    Ok(length) => {
                        sum += length;
                        written += 1;
                    }
                    Err(error) => report.broken.push((source.path().to_owned(), error.to_string())),
                }
            }
            done += chunk.len();
            progress(done, total);
        }
        report.frames += written;
        report.subjects.push(UnposedSubject {
            subject: (*subject).to_owned(),
            frames: written,
            betas: fit.betas,
            residual_mm: 1000.0 * fit.rms,
        });
    }
    if report.frames == 0 {
        let reason = report.broken.first().map_or_else(String::new, |(_, why)| format!(": {why}"));
        return Err(Error::Data(format!("{}: no frame can be unposed{reason}", raw.display())));
    }
    report.displacement_mm = 1000.0 * sum / report.frames as f64;
    for (name, body) in used {
        body.save(staging.path.join(name))?;
    }
    if !genders.is_empty() {
        write_genders(&staging.path, &genders)?;
    }
    let clothing = raw.join(raw::CLOTHING_FILE);
    if clothing.is_file() {
        let indices = cape_core::npy::read_i64(&clothing)?;
        write_npy(staging.path.join(raw::CLOTHING_FILE), &indices)?;
    }
    staging.commit(out)?;
    Ok(report)
}

/// Subjects with their frames, in the order of the names.
fn plan(tree: &RawTree) -> Vec<(&str, Vec<&FrameSource>)> {
    let frames = |subject| tree.captures(subject).iter().flat_map(RawCapture::frames).collect();
    let subjects = tree.subjects().map(|subject| (subject, frames(subject)));
    subjects.filter(|(_, frames): &(_, Vec<_>)| !frames.is_empty()).collect()
}

/// The unposed frame, and the mean length of its displacements, metres.
fn unpose_frame(
    source: &FrameSource,
    minimal: &Array2<f64>,
    body: &SmplModel,
) -> Result<(RawFrame, f64)> {
    let posed = source.posed(body.vertices())?;
    let v_cano = body
        .unpose_shape(&posed.v_posed, minimal, &posed.pose, posed.transl)
        .map_err(|error| Error::format(source.path(), error.to_string()))?;
    let lengths = (&v_cano - minimal).map_axis(ndarray::Axis(1), |d| d.dot(&d).sqrt());
    let length = lengths.mean().unwrap_or(0.0);
    Ok((RawFrame { v_cano, ..posed }, length))
}

#[cfg(test)]
mod tests {
    use cape_synth::{CaptureGenerator, SynthSpec, synthetic_body};

    use std::fs;

    use super::*;
    use cape_core::{silent, smpl::Gender};

    #[test]
    fn subjects_are_unposed_by_the_bodies_of_their_genders() {
        let root = tempfile::tempdir().unwrap();
        let [raw_tree, out] = ["raw", "out"].map(|name| root.path().join(name));
        let male = synthetic_body();
        let mut female = male.clone();
        female.v_template.column_mut(1).mapv_inplace(|y| 0.9 * y);
        let bodies = SubjectBodies::Genders { male: &male, female: &female };
        let spec = SynthSpec {
            subjects: 2,
            frames_per_sequence: 2,
            motions: vec![cape_synth::Motion::Squats],
            ..SynthSpec::default()
        };
        CaptureGenerator::new(bodies, spec).unwrap().write(&raw_tree, &mut silent).unwrap();
        let report = unpose(&raw_tree, &out, bodies, 10, &mut silent).unwrap();
        assert_eq!((report.frames, report.broken.len()), (16, 0));
        assert!(report.subjects.iter().all(|subject| subject.residual_mm < 1e-3), "{report:?}");
        let tree = RawTree::open(&out).unwrap();
        assert_eq!(tree.genders().unwrap(), RawTree::open(&raw_tree).unwrap().genders().unwrap());
        for (gender, body) in [(Gender::Male, &male), (Gender::Female, &female)] {
            let path = tree.body_path(Some(gender)).unwrap();
            assert_eq!(SmplModel::load(path).unwrap(), *body);
        }
        assert_eq!(tree.body_path(None), None);
        // With the bodies exchanged, no shape fits; without genders, no body is known.
        let exchanged = SubjectBodies::Genders { male: &female, female: &male };
        let elsewhere = root.path().join("exchanged");
        let report = unpose(&raw_tree, elsewhere, exchanged, 2, &mut silent).unwrap();
        assert!(report.subjects.iter().all(|subject| subject.residual_mm > 1.0), "{report:?}");
        fs::remove_file(raw_tree.join(GENDERS_FILE)).unwrap();
        let message =
            unpose(&raw_tree, root.path().join("none"), bodies, 10, &mut silent).unwrap_err();
        assert!(message.to_string().contains("s0001: unknown gender"), "{message}");
    }

    #[test]
    fn synthetic_captures_are_unposed_to_what_they_were_made_of() {
        let root = tempfile::tempdir().unwrap();
        let raw_tree = root.path().join("raw");
        let body = synthetic_body();
        let spec = SynthSpec { subjects: 1, frames_per_sequence: 3, ..SynthSpec::default() };
        CaptureGenerator::new(&body, spec).unwrap().write(&raw_tree, &mut silent).unwrap();
        let tree = RawTree::open(&raw_tree).unwrap();
        let frames = plan(&tree).remove(0).1;
        let frames: Vec<PathBuf> = frames.iter().map(|frame| frame.path().to_owned()).collect();
        let expected: Vec<RawFrame> =
            frames.iter().map(|path| raw::read_frame(path, None).unwrap()).collect();
        // Frames without canonical vertices, one of them without translation.
        for (index, (path, frame)) in frames.iter().zip(&expected).enumerate() {
            let mut file = cape_core::npy::NpzWriter::create(path).unwrap();
            file.add("v_posed", &frame.v_posed).unwrap();
            file.add("pose", &ndarray::arr1(&frame.pose)).unwrap();
            if index > 0 || frame.transl != [0.0; 3] {
                file.add("transl", &ndarray::arr1(&frame.transl)).unwrap();
            }
            file.finish().unwrap();
        }
        fs::write(&frames[1], "x").unwrap();
        let out = root.path().join("out");
        let report = unpose(&raw_tree, &out, &body, 10, &mut silent).unwrap();
        assert_eq!((report.frames, report.broken.len()), (frames.len() - 1, 1));
        assert!(report.broken[0].1.contains("npz"), "{:?}", report.broken);
        assert!(report.subjects[0].residual_mm < 1.0, "{report:?}");
        assert!((1.0..50.0).contains(&report.displacement_mm), "{}", report.displacement_mm);
        for (path, expected) in frames.iter().zip(&expected).skip(2) {
            let found = raw::read_frame(out.join(path.strip_prefix(&raw_tree).unwrap()), None);
            let found = found.unwrap();
            let difference = &found.v_cano - &expected.v_cano;
            assert!(difference.iter().all(|d| d.abs() < 1e-6), "{}", path.display());
            assert_eq!(found.pose, expected.pose);
        }
        assert!(out.join(raw::BODY_FILE).is_file());
        assert_eq!(RawTree::open(&out).unwrap().genders().unwrap().len(), 0);
        let message = unpose(&out, &out, &body, 10, &mut silent).unwrap_err().to_string();
        assert!(message.contains("already exists"), "{message}");
    }
}
