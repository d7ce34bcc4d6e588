//! Broken and hostile files: `cargo test --release --test fuzz`.
//!
//! Valid files are changed at random (bits, numbers where lengths are likely, pieces cut out, put
//! in twice or taken from another file) and read. No reader may panic, take long, or take memory
//! out of proportion to the file, but for pictures, whose sides are bounded. `CAPE_FUZZ_CASES=N` reads N
//! changed files of each kind. `CAPE_FUZZ_CORPUS=DIR` writes the valid files for the target of `fuzz/`.

#![allow(unreachable_pub)]

mod readers;
mod seeds;
#[path = "../../crates/cape-cli/tests/cli/tf_writer.rs"]
mod tf_writer;

use std::{
    fs,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    time::Instant,
};

use cape::{
    core::{
        Mesh, PointCacheFormat, PointCacheWriter,
        npy::{NpzWriter, write_npy},
        obj::{self, Uv},
        ply,
    },
    data::SplitSpec,
    infer::RunConfig,
    model::weights::{self, HostArray},
    synth::synthetic_body,
};
use ndarray::{Array2, arr1};
use peak_alloc::PeakAlloc;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use seeds::{write_annotations, write_glb, write_images, write_model, write_motions};

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// Bytes of memory a reader may take for each byte of its file, and besides.
const PROPORTION: usize = 64;
const BESIDES: usize = 1 << 20;
/// Bytes of memory that a built-in body takes, which model files name.
const BODY: usize = 128 << 20;
/// Seconds that no file of some kilobytes may take.
const LONGEST: f64 = 5.0;
const CASES: usize = 1500;

/// Valid files of every kind.
fn seeds(directory: &Path) -> Vec<(&'static str, &'static str, Vec<Vec<u8>>)> {
    let at = |name: &str| directory.join(name);
    let mesh = Mesh {
        vertices: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [0.0, 1.0, -2.5e-3]],
        faces: vec![[0, 1, 2], [0, 2, 1]],
    };
    let uv = Uv { coordinates: vec![[0.0, 0.5]; 3], faces: mesh.faces.clone() };
    obj::write(at("1.obj"), &mesh, Some(&uv)).unwrap();
    fs::write(
        at("2.obj"),
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nf -4/1 -3/1 \\\n-2/1 -1/1\n",
    )
    .unwrap();
    ply::write(at("1.ply"), &mesh, Some(&[[1, 2, 3]; 3])).unwrap();
    let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
                property float z\nelement face 1\nproperty list uchar int vertex_indices\n\
                end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    fs::write(at("2.ply"), text).unwrap();
    fs::write(
        at("1.stl"),
        "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n\
        vertex 0 1 0\nendloop\nendfacet\nendsolid a\n",
    )
    .unwrap();
    let mut binary = vec![b' '; 80];
    binary.extend(1u32.to_le_bytes());
    binary.extend([1u8; 50]);
    fs::write(at("2.stl"), binary).unwrap();
    fs::write(at("1.off"), "OFF3 1 0\n0 0 0\n1 0 0 # a\n\n0 1 0\n3 0 1 2 255 0 0\n").unwrap();
    fs::write(at("2.off"), "NOFF\n3 1 0\n0 0 0 0 0 1\n1 0 0 0 0 1\n0 1 0 0 0 1\n3 0 1 2\n")
        .unwrap();
    write_glb(&at("1.glb"), 1);
    write_glb(&at("2.glb"), 2);
    write_motions(directory);
    write_annotations(directory);
    write_images(directory);
    write_model(&at("1.model.safetensors"));
    for (name, format) in [("1.pc2", PointCacheFormat::Pc2), ("1.mdd", PointCacheFormat::Mdd)] {
        let mut cache = PointCacheWriter::create(at(name), format, [2, 3], 30.0).unwrap();
        cache.push(&mesh.vertices).unwrap();
        cache.push(&mesh.vertices).unwrap();
        cache.finish().unwrap();
    }
    write_npy(at("1.npy"), &Array2::<f64>::eye(5)).unwrap();
    write_npy(at("2.npy"), &arr1(&[1i64, 5, 7])).unwrap();
    let mut npz = NpzWriter::create(at("1.npz")).unwrap().deflate();
    npz.add("mean", &Array2::<f64>::zeros((4, 3))).unwrap();
    npz.add("std", &Array2::<f64>::ones((4, 3))).unwrap();
    npz.finish().unwrap();
    let mut npz = NpzWriter::create(at("2.npz")).unwrap();
    for name in ["v_cano", "v_posed"] {
        npz.add(name, &Array2::<f32>::zeros((4, 3))).unwrap();
    }
    npz.add("pose", &ndarray::Array1::<f64>::zeros(72)).unwrap();
    npz.add("transl", &arr1(&[0.0, 1.0, 2.0])).unwrap();
    npz.finish().unwrap();
    let array = |shape: &[usize]| HostArray {
        shape: shape.to_vec(),
        values: vec![0.5; shape.iter().product()],
    };
    let named = [("a.weight", array(&[3, 2])), ("b", array(&[4]))];
    let named = named.map(|(name, array)| (name.to_owned(), array));
    weights::save(&named.into_iter().collect(), at("1.safetensors")).unwrap();
    RunConfig::default().save(&at("1.toml")).unwrap();
    fs::write(at("2.toml"), SplitSpec::male().to_toml().unwrap()).unwrap();
    fs::write(at("1.yaml"), "name: a\nnz: 18\nF: [64, 64]\nlr: 8e-3\nseed: 3\n").unwrap();
    fs::write(at("2.yaml"), "# c\n\"a\": 'b'\nb: >\n  long\n  text\nc: {}\nd: &x [1, 2]\n")
        .unwrap();
    let variables = [
        ("generator/encoder/encoder_conv1/weights", vec![6, 4]),
        ("generator/encoder/fc_mean/dense/kernel", vec![8, 2]),
        ("generator/encoder/fc_mean/dense/kernel/Momentum", vec![8, 2]),
        ("generator/decoder/decoder_conv1/weights", vec![8, 4]),
    ];
    let variables: Vec<(String, HostArray)> =
        variables.into_iter().map(|(name, shape)| (name.to_owned(), array(&shape))).collect();
    tf_writer::write(directory, 7, &variables);
    fs::rename(at("model-7.index"), at("1.index")).unwrap();
    fs::rename(at("model-7.data-00000-of-00001"), at("1.data-00000-of-00001")).unwrap();

    let fixtures = Path::new("crates/cape-core/fixtures/pickles");
    let files: Vec<PathBuf> = [directory, fixtures]
        .into_iter()
        .flat_map(|directory| fs::read_dir(directory).unwrap())
        .map(|entry| entry.unwrap().path())
        .collect();
    readers::KINDS
        .into_iter()
        .map(|(kind, name)| {
            let ends = |path: &&PathBuf| {
                let file = path.file_name().unwrap().to_str().unwrap();
                file.split_once('.').is_some_and(|(_, end)| end == &name[2..])
            };
            let mut paths: Vec<&PathBuf> = files.iter().filter(ends).collect();
            paths.sort();
            assert!(!paths.is_empty(), "no valid file of kind {kind}");
            (kind, name, paths.into_iter().map(|path| fs::read(path).unwrap()).collect())
        })
        .collect()
}

/// One of the changes that break a format.
fn change(bytes: &mut Vec<u8>, other: &[u8], rng: &mut ChaCha8Rng) {
    const NUMBERS: [u64; 8] = [0, 1, 0x7f, 0xff, 0x7fff_ffff, 0xffff_ffff, u64::MAX >> 1, u64::MAX];
    if bytes.is_empty() {
        return bytes.extend(other.iter().take(16));
    }
    let at = rng.random_range(0..bytes.len());
    let length = rng.random_range(1..=32usize);
    let piece = at..(at + length).min(bytes.len());
    match rng.random_range(0..8) {
        0 => bytes[at] ^= 1 << rng.random_range(0..8),
        1 => bytes[at] = rng.random(),
        2 => {
            let number = NUMBERS[rng.random_range(0..NUMBERS.len())].to_le_bytes();
            let width = [1, 2, 4, 8][rng.random_range(0..4)];
            for (byte, new) in bytes[at..].iter_mut().zip(&number[..width]) {
                *byte = *new;
            }
        }
        3 => {
            // A number in text, made a large one.
            let digits = bytes[at..].iter().position(u8::is_ascii_digit).map(|found| at + found);
            if let Some(at) = digits {
                let large = b"99999999999999";
                bytes.splice(at..=at, large[..rng.random_range(1..large.len())].iter().copied());
            }
        }
        4 => drop(bytes.drain(piece)),
        5 => {
            let copy = bytes[piece.clone()].to_vec();
            bytes.splice(at..at, copy);
        }
        6 => bytes.truncate(at),
        _ => {
            let from = rng.random_range(0..other.len().max(1)).min(other.len());
            let taken = &other[from..(from + length).min(other.len())];
            bytes.splice(piece, taken.iter().copied());
        }
    }
}

fn put(directory: &Path, name: &str, bytes: &[u8], data: &[u8]) -> PathBuf {
    let path = directory.join(name);
    fs::write(&path, bytes).unwrap();
    // An index is read with its data, and data with their index.
    if name == "a.index" {
        fs::write(directory.join("a.data-00000-of-00001"), data).unwrap();
    }
    path
}

/// Writes valid files as the coverage-guided target reads them.
fn write_corpus(kinds: &[(&str, &str, Vec<Vec<u8>>)], directory: &Path) {
    let of = |kind: &str| &kinds.iter().find(|(found, ..)| *found == kind).unwrap().2;
    let [index, data] = ["tensorflow index", "tensorflow data"].map(|kind| &of(kind)[0]);
    let length = u16::try_from(index.len()).unwrap().to_le_bytes();
    let checkpoint = [&length[..], index, data].concat();
    for (number, (kind, _, seeds)) in kinds.iter().enumerate() {
        for (at, seed) in seeds.iter().enumerate() {
            let file = if kind.starts_with("tensorflow") { &checkpoint } else { seed };
            let name = format!("{}-{at}", kind.replace(' ', "-"));
            fs::write(directory.join(name), [&[number as u8], &file[..]].concat()).unwrap();
        }
    }
}

#[test]
fn no_file_makes_a_reader_panic_hang_or_take_the_memory() {
    let cases = std::env::var("CAPE_FUZZ_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(CASES);
    let directory = tempfile::tempdir().unwrap();
    let kinds = seeds(directory.path());
    if let Ok(corpus) = std::env::var("CAPE_FUZZ_CORPUS") {
        write_corpus(&kinds, Path::new(&corpus));
    }
    let place = tempfile::tempdir().unwrap();
    let of = |kind: &str| kinds.iter().find(|(found, ..)| *found == kind).unwrap().2[0].clone();
    let (index, data) = (of("tensorflow index"), of("tensorflow data"));
    // Read first, so that what is set up once is not counted.
    drop(synthetic_body());
    let mut total = 0;
    for (number, (kind, name, seeds)) in kinds.iter().enumerate() {
        let mut rng = ChaCha8Rng::seed_from_u64(number as u64);
        for seed in seeds {
            if kind.ends_with("data") {
                fs::write(place.path().join("a.index"), &index).unwrap();
            }
            let path = put(place.path(), name, seed, &data);
            readers::read(kind, &path);
        }
        let (mut taken, mut worst) = (0, 0);
        // Each model file has its body made.
        let cases = if *kind == "model" { cases / 50 } else { cases };
        for case in 0..cases {
            let mut bytes = seeds[rng.random_range(0..seeds.len())].clone();
            let other = &seeds[rng.random_range(0..seeds.len())];
            for _ in 0..rng.random_range(1..=4) {
                change(&mut bytes, other, &mut rng);
            }
            let path = put(place.path(), name, &bytes, &data);
            ALLOCATOR.reset_peak_usage();
            let (before, start) = (ALLOCATOR.current_usage(), Instant::now());
            let read = catch_unwind(AssertUnwindSafe(|| readers::read(kind, &path)));
            let seconds = start.elapsed().as_secs_f64();
            let memory = ALLOCATOR.peak_usage().saturating_sub(before);
            let picture = matches!(*kind, "png" | "jpeg");
            let allowed = match *kind {
                _ if picture => usize::MAX,
                "model" => PROPORTION * bytes.len() + BODY,
                _ => PROPORTION * bytes.len() + BESIDES,
            };
            if read.is_err() || seconds > LONGEST || memory > allowed {
                let kept = std::env::temp_dir().join(format!("cape-fuzz-{case}-{name}"));
                fs::write(&kept, &bytes).unwrap();
                panic!(
                    "{kind}: case {case}, {}: panic {}, {seconds:.2} s, {memory} bytes of memory \
                     for {} of file",
                    kept.display(),
                    read.is_err(),
                    bytes.len()
                );
            }
            taken += usize::from(read.unwrap_or(0) > 0);
            worst = worst.max(memory.saturating_sub(BESIDES) / bytes.len().max(1));
        }
        total += cases;
        println!(
            "{kind}: {cases} changed files, {taken} still readable, at most 1 MiB and {worst} times a \
             file of memory"
        );
    }
    println!("{total} files");
}
