//! A copy of the CAPE release as it lies on people's disks, from the download to table 2.

use std::{
    fmt::Write as _,
    fs,
    io::{Read, Write},
    path::{Path, PathBuf},
};

use cape::{
    core::{SmplModel, npy::NpzWriter},
    synth::synthetic_body,
};
use ndarray::{Array1, Array2};
use tempfile::TempDir;
use zip::{CompressionMethod, ZipArchive, ZipWriter, write::SimpleFileOptions};

use crate::support::{Ran, run};

/// Frames of a capture; four are cut off.
const FRAMES: usize = 12;
/// Captures of the two subjects of the male preset, and of one who is in none.
const CAPTURES: [(&str, &[&str]); 3] = [
    ("00032", &["longlong_hips", "longlong_soccer", "shortlong_hips", "shortlong_pose_model"]),
    ("00122", &["shortshort_hips", "shortshort_punching", "longlong_soccer", "poloshort_hips"]),
    ("00096", &["shirtshort_chicken_wings", "shortlong_hips"]),
];

/// The download: an archive for each subject beside `cape_release`, with the release's oddities.
struct Download {
    root: TempDir,
    body: SmplModel,
}

impl Download {
    fn new() -> Self {
        let root = tempfile::tempdir().unwrap();
        let download = Self { root, body: synthetic_body() };
        let release = download.at("cape_release");
        for (subject, captures) in CAPTURES {
            download.minimal(&release, subject);
            list(&release, subject, captures);
            download.archive(subject, captures);
            let place = download.at("minimal_body_params/minimal_body_shape").join(subject);
            let betas: Vec<f64> = (0..10).map(|i| 0.25 * f64::from(i)).collect();
            put(&place.join(format!("{subject}_param.pkl")), &parameters_pickle(&betas));
        }
        let genders: Vec<(&str, &str)> =
            ["00032", "00122", "00096", "03212", "03213"].map(|name| (name, "male")).to_vec();
        put(&release.join("misc/subj_genders.pkl"), &dictionary_pickle(&genders));
        download.body.save(download.at("SMPL_MALE.npz")).unwrap();
        fs::create_dir_all(download.at("models/smpl")).unwrap();
        fs::copy(download.at("SMPL_MALE.npz"), download.at("models/smpl/SMPL_MALE.npz")).unwrap();
        download
    }

    fn at(&self, name: &str) -> PathBuf {
        self.root.path().join(name)
    }

    /// Runs a command line in which `@` stands for the directory.
    fn run(&self, line: &str) -> Ran {
        let root = self.root.path().to_str().unwrap();
        run(line.split_whitespace().map(|word| word.replace('@', root)))
    }

    fn shape(&self, subject: &str) -> Array2<f64> {
        let scale = if subject == "00122" { 1.02 } else { 0.99 };
        self.body.v_template.mapv(|x| scale * x)
    }

    fn minimal(&self, release: &Path, subject: &str) {
        let place = release.join("minimal_body_shape").join(subject);
        fs::create_dir_all(&place).unwrap();
        let path = place.join(format!("{subject}_minimal.npy"));
        cape::core::npy::write_npy(path, &self.shape(subject)).unwrap();
    }

    /// Contents of a frame: float32 and compressed for one subject, float64 and stored for others.
    fn frame(&self, subject: &str, capture: &str, number: usize) -> Vec<u8> {
        let pose = Array1::from_shape_fn(72, |i| 0.2 * (i as f64 + 0.6 * number as f64).sin());
        let phase = capture.len() as f64 + 0.3 * number as f64;
        let v_cano = self.shape(subject)
            + Array2::from_shape_fn((6890, 3), |(v, axis)| {
                0.01 * (0.002 * v as f64 + axis as f64 + phase).sin()
            });
        let path = self.at(".frame.npz");
        let file = NpzWriter::create(&path).unwrap();
        if subject == "00122" {
            let single = |x: f64| x as f32;
            let mut file = file.deflate();
            file.add("v_cano", &v_cano.mapv(single)).unwrap();
            file.add("v_posed", &v_cano.mapv(single)).unwrap();
            file.add("pose", &pose.mapv(single)).unwrap();
            file.add("transl", &Array1::<f32>::zeros(3)).unwrap();
            file.finish().unwrap();
        } else {
            let mut file = file;
            file.add("v_cano", &v_cano).unwrap();
            file.add("v_posed", &v_cano).unwrap();
            file.add("pose", &pose).unwrap();
            file.add("transl", &Array1::<f64>::zeros(3)).unwrap();
            file.finish().unwrap();
        }
        fs::read(path).unwrap()
    }

    fn archive(&self, subject: &str, captures: &[&str]) {
        let file = fs::File::create(self.at(&format!("{subject}.zip"))).unwrap();
        let mut archive = ZipWriter::new(file);
        let method = if subject == "00032" {
            CompressionMethod::Deflated
        } else {
            CompressionMethod::Stored
        };
        let options = SimpleFileOptions::default().compression_method(method);
        let mut add = |name: String, bytes: &[u8]| {
            archive.start_file(name, options).unwrap();
            archive.write_all(bytes).unwrap();
        };
        add(format!("__MACOSX/{subject}/longlong_hips/._longlong_hips.000001.npz"), b"fork");
        for capture in captures {
            // Frames of the release are counted from 1; the broken ones have its numbers.
            let first = if capture.ends_with("punching") { 140 } else { 1 };
            for number in first..first + FRAMES {
                let name = format!("{subject}/{capture}/{capture}.{number:06}.npz");
                let mut bytes = self.frame(subject, capture, number);
                if capture.ends_with("punching") && number == 147 {
                    bytes.truncate(bytes.len() / 2);
                }
                add(name, &bytes);
            }
            if capture.ends_with("chicken_wings") {
                let name = format!("{subject}/{capture}/{capture}.000108.npz5JRYHz-numpy.npy");
                add(name, b"left by an interrupted write");
            }
        }
        archive.finish().unwrap();
    }

    /// Unpacks the archives into `place`.
    fn unpack(&self, place: &Path) {
        for (subject, _) in CAPTURES {
            let file = fs::File::open(self.at(&format!("{subject}.zip"))).unwrap();
            let mut archive = ZipArchive::new(file).unwrap();
            for index in 0..archive.len() {
                let mut entry = archive.by_index(index).unwrap();
                let name = entry.name().unwrap().to_string();
                let mut bytes = Vec::new();
                entry.read_to_end(&mut bytes).unwrap();
                put(&place.join(name), &bytes);
            }
        }
    }
}

/// List with one capture that is not there, and ranges of frames that were removed.
fn list(release: &Path, subject: &str, captures: &[&str]) {
    let mut text = format!("subject {subject}\n\nsequence\tvalid frames\tremoved\n");
    for (index, name) in captures.iter().enumerate() {
        let removed = if index == 0 { "3-5,9-9" } else { "" };
        writeln!(text, "{name}\t{FRAMES}\t{removed}").unwrap();
    }
    if subject == "00032" {
        text += "longshort_squats\t80\t\n";
    }
    put(&release.join(format!("seq_lists/seq_list_{subject}.txt")), text.as_bytes());
}

fn put(path: &Path, bytes: &[u8]) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

fn short_string(text: &str) -> Vec<u8> {
    [&[b'U', text.len() as u8], text.as_bytes()].concat()
}

/// Python 2's pickle of a dictionary of strings.
fn dictionary_pickle(items: &[(&str, &str)]) -> Vec<u8> {
    let mut bytes = b"\x80\x02}(".to_vec();
    for (key, value) in items {
        bytes.extend(short_string(key));
        bytes.extend(short_string(value));
    }
    bytes.extend(b"u.");
    bytes
}

/// Python 2's pickle of `{"betas": numpy.array(betas)}`.
fn parameters_pickle(betas: &[f64]) -> Vec<u8> {
    let mut bytes = b"\x80\x02}".to_vec();
    bytes.extend(short_string("betas"));
    bytes.extend(
        b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R(K\x01",
    );
    bytes.extend([b'K', betas.len() as u8]);
    bytes.extend(b"\x85cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R(K\x03U\x01<NNN");
    bytes.extend(b"J\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89");
    bytes.push(b'T');
    bytes.extend((8 * betas.len() as u32).to_le_bytes());
    bytes.extend(betas.iter().flat_map(|x| x.to_le_bytes()));
    bytes.extend(b"tbs.");
    bytes
}

#[test]
fn a_download_becomes_table_2() {
    let download = Download::new();
    let text = download.run("data inspect @ --preset male --body @/SMPL_MALE.npz").succeeded();
    for said in [
        "poloshort",
        "shirtshort",
        "read from archives without unpacking: 00032 00096 00122",
        "male: 00032 00096 00122",
        "subj_genders.pkl lists 03212 and 03213, of whom the release has no captures",
        "shape coefficients of 00032 00096 00122",
        "00096/shirtshort_chicken_wings/shirtshort_chicken_wings.000108.npz5JRYHz-numpy.npy: not read",
        "00122/shortshort_punching/shortshort_punching.000147.npz: known to be broken",
        "00096/shirtshort_chicken_wings: 13 frames, the list has 12 (4 more were removed)",
        "00032: listed but missing: longshort_squats",
        "preset male: 32 of 31036 training frames, 31004 missing",
        "preset male: 24 of 5128 test frames",
        "missing subjects: 03284 00215 00127 02474 03394",
        "missing captures: 00032/longshort_squats",
    ] {
        assert!(text.contains(said), "`{said}` is not in:\n{text}");
    }
    let summary = download.run("info @").succeeded();
    assert!(summary.contains("raw captures") && summary.contains("poloshort"), "{summary}");

    let ran = download.run("data pack @ --preset male --out @/packed --json");
    assert!(ran.err.contains("left out 00122/shortshort_punching"), "{}", ran.err);
    let report = ran.json();
    // One frame is broken; other outfits than the preset's are left out.
    assert_eq!((&report["train_frames"], &report["test_frames"]), (&31.into(), &24.into()));

    // The same from the directory of the release, and unpacked in both of the usual places.
    let same = |name: &str, root: &str| {
        download.run(&format!("data pack {root} --preset male --out @/{name} --quiet")).succeeded();
        for file in ["train/train_disp.npy", "test/test_pose.npy", "train/train_frames.csv"] {
            let read = |set: &str| fs::read(download.at(set).join(file)).unwrap();
            assert!(read(name) == read("packed"), "{name}: {file}");
        }
    };
    same("of_release", "@/cape_release");
    download.unpack(&download.at("cape_release/sequences"));
    let notes = download.run("data inspect @ --frames 1").succeeded();
    assert!(notes.contains("00032.zip: not read"), "{notes}");
    same("of_sequences", "@");
    fs::rename(download.at("cape_release/sequences"), download.at("unpacked")).unwrap();
    for (subject, _) in CAPTURES {
        fs::rename(download.at("unpacked").join(subject), download.at(subject)).unwrap();
        fs::remove_file(download.at(&format!("{subject}.zip"))).unwrap();
    }
    same("of_directories", "@");

    // Other outfits by a split of one's own.
    let split = "subjects = ['00122']\noutfits = ['poloshort', 'shortshort']\ncut = 2\n\
                 [labels]\npoloshort = 'shortshort'\n[train]\nsequences = ['hips']\n";
    fs::write(download.at("split.toml"), split).unwrap();
    let polo = download.run("data pack @ --split @/split.toml --out @/polo --json").json();
    assert_eq!(polo["train_frames"], 16);
    fs::remove_file(download.at("split.toml")).unwrap();

    let options = "--data @/packed --body @/models --gender male";
    let female = download.run("train --data @/packed --body @/models --gender female --out @/run");
    female.failed_saying(&["SMPL_FEMALE", "models"]);
    download.run("train --data @/packed --body @/models --out @/run").failed_saying(&["--gender"]);
    download
        .run(&format!("train {options} --out @/run --preset tiny --epochs 1 --quiet"))
        .succeeded();
    let evaluation = download.run("eval run @/run --data @/packed --json").json();
    assert_eq!(evaluation["frames"], 24);
    let line =
        format!("table2 {options} --out @/table --preset tiny --epochs 1 --rows mean,pca,cape");
    let table = download.run(&format!("{line} --json")).json();
    assert_eq!(table["lines"].as_array().unwrap().len(), 3);
    assert_eq!((&table["frames"], &table["captures"]), (&24.into(), &3.into()));
}

#[test]
fn damaged_downloads_are_named() {
    let root = tempfile::tempdir().unwrap();
    let at = |name: &str| root.path().join(name);
    let inspect = || run(["data", "inspect", root.path().to_str().unwrap()]);
    inspect().failed_saying(&["neither raw data", "cape_release"]);
    put(&at("cape_release/minimal_body_shape/00032/00032_minimal.npy"), b"none");
    put(&at("00032.zip"), b"<html>log in</html>");
    inspect().failed_saying(&["00032.zip", "ZIP", "download it again"]);
    fs::remove_file(at("00032.zip")).unwrap();
    put(&at("00032/longlong_hips/longlong_hips.000001.npz"), b"none");
    let text = inspect().succeeded();
    assert!(text.contains("00032: no minimal shape"), "{text}");
    put(&at("cape_release/seq_lists/seq_list_00032.txt"), b"a\nb\nc\nlonglong_hips\tmany\n");
    inspect().failed_saying(&["seq_list_00032.txt", "line 4"]);
}
