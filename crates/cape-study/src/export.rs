//! A study as a static folder of jsPsych, or as a package of JATOS.

use std::{
    collections::BTreeMap,
    fs,
    io::{Cursor, Write},
    path::Path,
};

use cape_core::{Error, Result, hex};
use serde_json::json;
use sha2::{Digest, Sha256};
use zip::{CompressionMethod, DateTime, ZipWriter, write::SimpleFileOptions};

use crate::{PairKind, StimulusPair, StudyDesign, consent, design::STIMULI, web};

/// Directory of the study inside a JATOS package.
const FOLDER: &str = "cape_study";

/// Where an exported study sends its answers.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ExportOptions {
    /// Number of schedules; raters beyond it repeat them.
    pub schedules: usize,
    /// Page to go to at the end, such as Prolific's completion link.
    pub completion: Option<String>,
    /// Experiment of DataPipe to send answers to.
    pub pipe: Option<String>,
}

/// Files of a static folder by their path. None tells which picture of a scored pair is real.
///
/// # Errors
/// If a picture cannot be read.
pub fn export_files(
    design: &StudyDesign,
    directory: impl AsRef<Path>,
    options: &ExportOptions,
) -> Result<BTreeMap<String, Vec<u8>>> {
    let directory = directory.as_ref();
    let mut files: BTreeMap<String, Vec<u8>> = web::EXPORTED
        .iter()
        .map(|&(name, text)| (name.to_owned(), text.as_bytes().to_vec()))
        .collect();
    for name in design.stimuli() {
        let path = directory.join(STIMULI).join(name);
        let bytes = fs::read(&path).map_err(|source| Error::io(&path, source))?;
        files.insert(format!("{STIMULI}/{name}"), bytes);
    }
    let data = data(design, &consent(directory)?, options);
    files.insert("study-data.js".into(), format!("window.CAPE_STUDY = {data};\n").into_bytes());
    Ok(files)
}

fn data(design: &StudyDesign, consent: &[String], options: &ExportOptions) -> serde_json::Value {
    let schedules: Vec<Vec<[usize; 2]>> = (0..options.schedules.max(1))
        .map(|rater| {
            let trials = design.schedule(rater).into_iter();
            let place = |pair: usize, left: &str| design.pairs[pair].files()[0] != left;
            trials.map(|trial| [trial.pair, usize::from(place(trial.pair, &trial.left))]).collect()
        })
        .collect();
    let practice: BTreeMap<usize, &str> = design
        .of_kind(PairKind::Practice)
        .into_iter()
        .map(|pair| (pair, design.pairs[pair].real.file.as_str()))
        .collect();
    json!({
        "id": identity(design),
        "consent": consent,
        "pairs": design.pairs.iter().map(StimulusPair::files).collect::<Vec<_>>(),
        "schedules": schedules,
        "practice": practice,
        "completion": options.completion,
        "pipe": options.pipe,
    })
}

/// Hash of the pictures and their pairs.
fn identity(design: &StudyDesign) -> String {
    let mut hash = Sha256::new();
    for pair in &design.pairs {
        pair.files().iter().for_each(|file| hash.update(file));
    }
    hex(&hash.finalize()[..16])
}

/// A `.jzip` package of JATOS of the files of [`export_files`].
///
/// # Errors
/// If the archive cannot be written.
pub fn jatos_package(design: &StudyDesign, files: &BTreeMap<String, Vec<u8>>) -> Result<Vec<u8>> {
    let fault = |error: String| Error::format("study.jzip", error);
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::default());
    let mut add = |name: &str, bytes: &[u8]| -> Result<()> {
        archive.start_file(name, options).map_err(|error| fault(error.to_string()))?;
        archive.write_all(bytes).map_err(|error| fault(error.to_string()))
    };
    add(&format!("{FOLDER}.jas"), study_file(design).to_string().as_bytes())?;
    for (name, bytes) in files {
        let path = format!("{FOLDER}/{name}");
        if name == "index.html" {
            let page = String::from_utf8_lossy(bytes);
            let page = page.replace("<!-- JATOS -->", "<script src=\"jatos.js\"></script>");
            add(&path, page.as_bytes())?;
        } else {
            add(&path, bytes)?;
        }
    }
    let written = archive.finish().map_err(|error| fault(error.to_string()))?;
    Ok(written.into_inner())
}

/// The description of a study in JATOS's format, version 3.
fn study_file(design: &StudyDesign) -> serde_json::Value {
    let uuid = |what: &str| {
        let hash = hex(&Sha256::digest(format!("{} {what}", identity(design)))[..16]);
        let parts = [&hash[..8], &hash[8..12], &hash[12..16], &hash[16..20], &hash[20..]];
        parts.join("-")
    };
    json!({
        "version": "3",
        "data": {
            "uuid": uuid("study"),
            "title": "Which one is real?",
            "description": "Two dressed people side by side, one captured, one generated.",
            "active": true,
            "groupStudy": false,
            "linearStudy": false,
            "allowPreview": false,
            "dirName": FOLDER,
            "comments": "",
            "jsonData": null,
            "endRedirectUrl": "",
            "studyEntryMsg": null,
            "componentList": [{
                "uuid": uuid("component"),
                "title": "Pairs",
                "htmlFilePath": "index.html",
                "reloadable": true,
                "active": true,
                "comments": "",
                "jsonData": null
            }],
            "batchList": [{
                "uuid": uuid("batch"),
                "title": "Default",
                "active": true,
                "maxActiveMembers": null,
                "maxTotalMembers": null,
                "maxTotalWorkers": null,
                "allowedWorkerTypes": [
                    "PersonalSingle", "Jatos", "PersonalMultiple", "MT", "GeneralSingle", "GeneralMultiple"
                ],
                "comments": null,
                "jsonData": null
            }]
        }
    })
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;
    use crate::simulation::tests::design;

    #[test]
    fn exported_files_tell_nothing_and_make_a_package() {
        let design = design(10, 2, 1, 10);
        let directory = tempfile::tempdir().unwrap();
        fs::create_dir(directory.path().join(STIMULI)).unwrap();
        for name in design.stimuli() {
            fs::write(directory.path().join(STIMULI).join(name), name).unwrap();
        }
        fs::write(directory.path().join("consent.txt"), "One.\n\nTwo.\n").unwrap();
        let options = ExportOptions { schedules: 4, ..ExportOptions::default() };
        let files = export_files(&design, directory.path(), &options).unwrap();
        let script = String::from_utf8(files["study-data.js"].clone()).unwrap();
        let data = script.strip_prefix("window.CAPE_STUDY = ").unwrap();
        let data: serde_json::Value =
            serde_json::from_str(data.trim_end().trim_end_matches(';')).unwrap();
        assert_eq!(data["consent"], json!(["One.", "Two."]));
        assert_eq!(data["practice"].as_object().unwrap().len(), 1);
        for (rater, schedule) in data["schedules"].as_array().unwrap().iter().enumerate() {
            for (trial, found) in design.schedule(rater).iter().zip(schedule.as_array().unwrap()) {
                let flip = found[1].as_u64().unwrap() as usize;
                assert_eq!(data["pairs"][trial.pair][flip], trial.left);
                assert_eq!(data["pairs"][trial.pair][1 - flip], trial.right);
            }
        }
        let package = jatos_package(&design, &files).unwrap();
        let mut archive = zip::ZipArchive::new(Cursor::new(package)).unwrap();
        let mut text = String::new();
        archive.by_name("cape_study/index.html").unwrap().read_to_string(&mut text).unwrap();
        assert!(text.contains("jatos.js"));
        assert_eq!(archive.len(), files.len() + 1);
    }
}
