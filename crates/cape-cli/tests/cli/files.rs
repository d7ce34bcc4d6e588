//! Files of other programs, in and out.

use std::{fs, path::Path};

use cape::{
    core::{
        Mesh, SmplModel,
        npy::{Npz, NpzWriter},
        obj::{self, Uv},
    },
    data::raw,
    model::weights::{self, HostArray},
};
use ndarray::{Array2, arr1};
use serde_json::Value;

use crate::{
    support::{Packed, VERTICES, contents, trained},
    tf_writer,
};

/// A run with the release's up-sampling weights and groups of the normalisations, its weights as a checkpoint of the
/// release, and what else an import needs.
fn released() -> (Packed, Vec<(String, HostArray)>) {
    let data = Packed::new();
    let train = |run: &str, options: &str| {
        data.run(&format!("train --data @/packed --out @/{run} {options}")).succeeded();
    };
    train("first", "--preset tiny --epochs 1 --batch 4 --weighting release");
    let config = fs::read_to_string(data.at("first/config.toml")).unwrap();
    assert!(config.contains("group_channels = 8\n"), "{config}");
    fs::write(data.at("release.toml"), config.replace("group_channels = 8\n", "")).unwrap();
    train("run", "--config @/release.toml");
    data.run("model export @/run --npz @/weights.npz --safetensors @/weights.safetensors")
        .succeeded();
    let mut npz = Npz::open(data.at("weights.npz")).unwrap();
    let variables: Vec<(String, HostArray)> = npz
        .names()
        .into_iter()
        .map(|name| {
            let array = npz.f32(&name).unwrap();
            let shape = array.shape().to_vec();
            let name = name.trim_end_matches(":0").to_owned();
            (name, HostArray { shape, values: array.iter().copied().collect() })
        })
        .collect();
    (data, variables)
}

const IMPORT: &str = "model import --tf-checkpoint @/tf --stats @/run/stats.npz --body @/run/body.npz \
                      --clothing @/run/clothing_verts_idx.npy --factors 1,2,1,1";

#[test]
fn an_official_checkpoint_becomes_the_same_run() {
    let (data, variables) = released();
    let exported = weights::load(data.at("weights.safetensors")).unwrap();
    assert_eq!(exported.len(), variables.len());
    assert!(variables.iter().any(|(name, _)| name == "generator/decoder/fc1/dense/kernel"));
    let mut saved = variables.clone();
    for (name, array) in &variables {
        let values = array.values.iter().map(|x| 0.5 * x).collect();
        let velocity = HostArray { shape: array.shape.clone(), values };
        saved.push((format!("{name}/Momentum"), velocity));
    }
    saved.push((
        "loss/ExponentialMovingAverage".into(),
        HostArray { shape: vec![], values: vec![1.0] },
    ));
    tf_writer::write(&data.at("tf"), 4, &saved);
    fs::write(data.at("cape.yaml"), "name: test\nnz: 6\nlr: 0.002\nlambda_gan: 0.2\n").unwrap();

    let ran = data.run(&format!("{IMPORT} --config @/cape.yaml --out @/imported --json"));
    assert!(ran.err.contains("settings ignored: name"), "{}", ran.err);
    let report = ran.json();
    assert_eq!(report["step"], 4);
    assert_eq!(report["variables"], variables.len());
    assert_eq!(report["velocities"], variables.len());
    assert_eq!(report["ignored"].as_array().unwrap().len(), 1);
    for run in ["run", "imported"] {
        data.run(&format!("sample @/{run} --out @/of_{run} --n 2 --no-picture --prior normal"))
            .succeeded();
    }
    assert!(contents(&data.at("of_run")) == contents(&data.at("of_imported")));
    let config = fs::read_to_string(data.at("imported/config.toml")).unwrap();
    assert!(config.contains("peak_rate = 0.002") && config.contains("gan = 0.2"), "{config}");
    assert!(config.contains("weighting = \"release\""), "{config}");

    // What comes out again is what went in.
    data.run("model export @/imported --npz @/again.npz").succeeded();
    assert_eq!(fs::read(data.at("again.npz")).unwrap(), fs::read(data.at("weights.npz")).unwrap());
    let velocities = data.at("imported/checkpoints/step-00000004/generator_momentum.safetensors");
    let velocity = &weights::load(&velocities).unwrap()["encoder.mean.weight"];
    let weight = &exported["generator.encoder.mean.weight"];
    assert!(velocity.values.iter().zip(&weight.values).all(|(v, w)| *v == 0.5 * w));

    // It evaluates, and trains on once it is told on what.
    data.run("eval run @/imported --data @/packed --map @/errors.ply").succeeded();
    assert_eq!(Mesh::load(data.at("errors.ply")).unwrap().vertices.len(), VERTICES);
    data.run("train --out @/imported --resume").failed_saying(&["no record of its packed set"]);
    data.run("train --out @/imported --data @/packed --resume").succeeded();
    let said = data.run("info @/tf").succeeded();
    assert!(said.contains("TensorFlow checkpoint") && said.contains("global_step"), "{said}");
}

#[test]
fn checkpoints_that_do_not_fit_are_named() {
    let (data, variables) = released();
    let import = |variables: &[(String, HostArray)], parts: &[&str]| {
        let _ = fs::remove_dir_all(data.at("tf"));
        tf_writer::write(&data.at("tf"), 4, variables);
        data.run(&format!("{IMPORT} --out @/imported")).failed_saying(parts);
        assert!(!data.at("imported").exists());
    };
    let without = |name: &str| -> Vec<(String, HostArray)> {
        variables.iter().filter(|(found, _)| found != name).cloned().collect()
    };
    let name = "generator/encoder/fc_var/dense/bias";
    import(&without(name), &[name, "missing", "model-4"]);
    let mut changed = variables.clone();
    changed
        .push(("generator/encoder/extra".into(), HostArray { shape: vec![1], values: vec![0.0] }));
    import(&changed, &["generator/encoder/extra", "no such variable"]);
    let mut changed = without(name);
    changed.push((name.into(), HostArray { shape: vec![5], values: vec![0.0; 5] }));
    import(&changed, &[name, "log_variance.bias", "[5]"]);
    let stranger = HostArray { shape: vec![2], values: vec![0.0; 2] };
    import(&[("encoder/conv1/weights".into(), stranger)], &["no variable of a CAPE model"]);

    tf_writer::write(&data.at("tf"), 4, &variables);
    let line = IMPORT.replace("--factors 1,2,1,1", "--factors 2,2,1,1");
    data.run(&format!("{line} --out @/imported")).failed_saying(&[
        "fc_mean",
        "[2, 2, 1, 1]",
        "down-sampling factors",
    ]);
    fs::write(data.at("cape.yaml"), "nz: 18\n").unwrap();
    data.run(&format!("{IMPORT} --config @/cape.yaml --out @/imported"))
        .failed_saying(&["cape.yaml", "`nz` is 18"]);
    let path = data.at("tf/model-4.data-00000-of-00001");
    let mut bytes = fs::read(&path).unwrap();
    bytes[77] ^= 1;
    fs::write(&path, bytes).unwrap();
    data.run(&format!("{IMPORT} --out @/imported")).failed_saying(&["damaged (checksum)"]);
    fs::remove_file(&path).unwrap();
    data.run(&format!("{IMPORT} --out @/imported")).failed_saying(&["data-00000-of-00001"]);
}

/// Texture coordinates of the run's body: a point for each vertex.
fn write_uv(data: &Packed) {
    let mesh = SmplModel::load(data.at("run/body.npz")).unwrap().mesh();
    let uv = Uv {
        coordinates: (0..VERTICES).map(|v| [v as f32 / VERTICES as f32, 0.5]).collect(),
        faces: mesh.faces.clone(),
    };
    obj::write(data.at("uv.obj"), &mesh, Some(&uv)).unwrap();
    fs::write(data.at("cloth.png"), b"\x89PNG\r\n\x1a\nnot a picture, but passed on").unwrap();
}

pub(crate) fn glb(path: &Path) -> Value {
    let bytes = fs::read(path).unwrap();
    assert_eq!(&bytes[..4], b"glTF");
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&bytes[20..20 + length]).unwrap()
}

#[test]
fn samples_come_as_animated_gltf_and_textured_meshes() {
    let data = Packed::new();
    data.train().succeeded();
    write_uv(&data);
    let poses = Array2::from_shape_fn((5, 72), |(f, i)| 0.1 * ((f + i) as f32).sin());
    cape::core::npy::write_npy(data.at("dance.npy"), &poses).unwrap();
    data.run(
        "sample @/run --out @/glb --format glb --outfit longlong --n 2 --pose @/dance.npy --fps 25 \
         --shape-targets 2 --uv @/uv.obj --texture @/cloth.png --name {pose}_{sample}",
    )
    .succeeded();
    let names: Vec<String> =
        contents(&data.at("glb")).into_iter().map(|(path, _)| path.display().to_string()).collect();
    let glbs: Vec<&String> = names.iter().filter(|name| name.contains(".glb")).collect();
    assert_eq!(glbs.len(), 2, "{names:?}");
    let document = glb(&data.at("glb").join(glbs[0]));
    assert_eq!(document["skins"][0]["joints"].as_array().unwrap().len(), 24);
    // Two shape targets, and key frames of five poses.
    let targets = document["meshes"][0]["weights"].as_array().unwrap().len();
    assert!((3..=7).contains(&targets), "{targets}");
    assert_eq!(document["images"][0]["mimeType"], "image/png");
    // Rotations have every frame, displacements their key frames.
    let samplers = document["animations"][0]["samplers"].as_array().unwrap();
    let inputs = samplers.iter().map(|sampler| sampler["input"].as_u64().unwrap() as usize);
    let times = inputs.map(|input| &document["accessors"][input]);
    let longest = times.max_by_key(|times| times["count"].as_u64()).unwrap();
    assert_eq!(
        (longest["count"].as_u64(), longest["max"][0].as_f64()),
        (Some(5), Some(0.16f32.into()))
    );

    data.run(
        "sample @/run --out @/obj --outfit longlong --uv @/uv.obj --texture @/cloth.png --no-picture",
    )
    .succeeded();
    let text = fs::read_to_string(data.at("obj/longlong_001.obj")).unwrap();
    assert!(text.starts_with("mtllib body.mtl\n") && text.contains("\nusemtl body\n"));
    assert_eq!(text.matches("\nvt ").count(), VERTICES);
    assert!(fs::read_to_string(data.at("obj/body.mtl")).unwrap().contains("map_Kd texture.png"));
    assert_eq!(
        fs::read(data.at("obj/texture.png")).unwrap(),
        fs::read(data.at("cloth.png")).unwrap()
    );
    data.run(
        "sample @/run --out @/ply --format ply --colours displacement --scale 20 --no-picture",
    )
    .succeeded();
    data.run("sample @/run --out @/a --name {outfit} --n 2").failed_saying(&["several meshes"]);
    data.run("sample @/run --out @/a --name {cat}").failed_saying(&["{cat}"]);
    data.run("sample @/run --out @/a --uv @/ply/longlong_001.ply").failed_saying(&["longlong_001"]);
    fs::write(data.at("cloth.gif"), "GIF89a").unwrap();
    data.run("sample @/run --out @/a --uv @/uv.obj --texture @/cloth.gif")
        .failed_saying(&["cloth.gif", "PNG or a JPEG"]);
    assert!(!data.at("a").exists());
}

#[test]
fn pickled_bodies_are_taken_wherever_a_body_is() {
    let fixtures = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-core/fixtures/pickles"));
    let info =
        |name: &str| crate::support::run(["info", &fixtures.join(name).display().to_string()]);
    let said = info("body_chumpy_python2_protocol2.pkl").succeeded();
    assert!(said.starts_with("body in SMPL's layout") && said.contains("joints"), "{said}");
    assert!(info("mixture_GMM.pkl").succeeded().contains("covars_"));
    assert!(info("object_array.npy").succeeded().contains("sparse [3, 5]"));
    info("bad_system.pkl").failed_saying(&["bad_system.pkl", "`posix.system`"]);
    info("bad_smplh.pkl").failed_saying(&["SMPL-H", "24 joints"]);
}

#[test]
fn data_are_inspected() {
    let data = trained();
    let said = data.run("data inspect @/raw").succeeded();
    assert!(said.starts_with("raw data, 96 frames") && said.contains("ann"), "{said}");
    let found = data.run("data inspect @/packed --frames 2 --json").json();
    assert_eq!((&found["kind"], &found["vertices"]), (&"packed".into(), &VERTICES.into()));
    assert!(found["clothing_mm"]["mean"].as_f64() > Some(0.0));
    data.run("data inspect @/run").failed_saying(&["neither raw data"]);
}

#[test]
fn variation_of_clothing_is_measured() {
    let data = trained();
    let measure = "data inspect @/packed --statistics";
    // Beside its own statistics all ratios are 1.
    let found = data.run(&format!("{measure} --reference @/packed/stats.npz --json")).json();
    let found = &found["clothing_statistics"];
    for ratio in ["mean_ratio", "std_ratio"] {
        for axis in 0..3 {
            let ratio = found["reference"][ratio][axis].as_f64().unwrap();
            assert!((ratio - 1.0).abs() < 1e-3, "{found}");
        }
    }
    let errors: Vec<f64> = found["components"]
        .as_array()
        .unwrap()
        .iter()
        .map(|error| error["error_mm"].as_f64().unwrap())
        .collect();
    assert!(errors.len() > 3 && errors[errors.len() - 1] < errors[0], "{errors:?}");
    let said = data.run(measure).succeeded();
    assert!(said.contains("wrinkles") && said.contains("explained variance"), "{said}");
    data.run("data inspect @/raw --statistics").failed_saying(&["packed", "cape data pack"]);
    data.run("data inspect @/packed --reference @/packed/stats.npz").misused(&["--statistics"]);
}

#[test]
fn own_registrations_are_unposed_and_packed() {
    let data = Packed::new();
    let body = SmplModel::load(data.at("raw/body.npz")).unwrap();
    for (path, _) in contents(&data.at("raw/sequences")) {
        let path = data.at("raw/sequences").join(path);
        let frame = raw::read_frame(&path, None).unwrap();
        let displacement = &frame.v_cano - &body.v_template;
        let transl = [0.5, 1.0, -0.5];
        let posed =
            body.pose_shape(&body.v_template, &frame.pose, transl, Some(&displacement)).unwrap();
        let mut file = NpzWriter::create(&path).unwrap();
        file.add("v_posed", &posed.vertices).unwrap();
        file.add("pose", &arr1(&frame.pose)).unwrap();
        file.add("transl", &arr1(&transl)).unwrap();
        file.finish().unwrap();
    }
    let report = data.run("data unpose @/raw --body @/raw/body.npz --out @/unposed --json").json();
    assert_eq!((&report["frames"], &report["broken"]), (&96.into(), &Value::Array(Vec::new())));
    assert!(report["subjects"][0]["residual_mm"].as_f64() < Some(1e-6));
    data.run("data pack @/unposed --split @/raw/split.toml --out @/again").succeeded();
    let read =
        |name: &str| cape::core::npy::read_f64(data.at(name).join("train/train_disp.npy")).unwrap();
    let difference = read("again") - read("packed");
    assert!(difference.iter().all(|d| d.abs() < 1e-9));
    data.run("data unpose @/raw --body @/uv.obj --out @/b").failed_saying(&["uv.obj"]);
}
