//! A clothing layer of its own topology: simulated, imported, tied, learned, predicted, reported.

use std::{
    fs,
    io::Write,
    path::Path,
    process::{Output, Stdio},
    sync::OnceLock,
};

use cape::{
    core::{
        Mesh, PointCacheFormat, PointCacheWriter, motion::UpAxis, npy::NpzWriter, smpl::Gender,
    },
    layer::LayerSet,
    synth::embedded_body,
};
use ndarray::Axis;
use tempfile::TempDir;

use crate::support::{Ran, cape, contents, run_line, truncate};

/// A short march in a coarse skirt.
pub(crate) fn skirt() -> &'static Path {
    static SKIRT: OnceLock<TempDir> = OnceLock::new();
    let place = SKIRT.get_or_init(|| {
        let place = tempfile::tempdir().unwrap();
        let out = place.path().join("set");
        let options = "--garment skirt --exercises march --frames 8 --resolution 50";
        let line = format!("layer synth {options} --out {} --json", out.display());
        let report = run_line(&line).json();
        assert_eq!((&report["sequences"], &report["frames"]), (&1.into(), &8.into()));
        place
    });
    Box::leak(place.path().join("set").into_boxed_path())
}

/// The set's first sequence as meshes and an archive, changed as wanted, in a directory of its own.
fn captured(change: impl Fn(usize, &mut Mesh)) -> TempDir {
    let place = tempfile::tempdir().unwrap();
    let set = LayerSet::load(skirt()).unwrap();
    let meshes = place.path().join("meshes");
    fs::create_dir(&meshes).unwrap();
    for frame in 0..set.frames() {
        let mut mesh = set.clothing(0, frame).unwrap().to_mesh();
        change(frame, &mut mesh);
        mesh.save(meshes.join(format!("{frame:04}.ply"))).unwrap();
    }
    let motion = &set.sequences[0].motion;
    let mut file = NpzWriter::create(place.path().join("smpl.npz")).unwrap();
    file.add("poses", &motion.poses).unwrap();
    file.add("trans", &motion.translations).unwrap();
    file.finish().unwrap();
    place
}

fn import(captured: &TempDir, set: &Path, name: &str) -> Ran {
    let at = |name: &str| captured.path().join(name).display().to_string();
    let (meshes, motion) = (at("meshes"), at("smpl.npz"));
    let set = set.display();
    let options = format!("--set {set} --name {name} --fps 30 --parameters length=0.85");
    run_line(&format!("layer import {meshes} {motion} {options} --json"))
}

#[test]
fn a_captured_skirt_is_worn_by_another_body() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    let (set, sequence) = (skirt().display(), LayerSet::load(skirt()).unwrap().sequences.remove(0));
    let transfer = |options: &str, out: &str| {
        run_line(&format!("layer transfer {set} {options} --out {} --json", at(out)))
    };
    // The wearer's own shape gives the capture back.
    let report = transfer("--clearance 0", "same").json();
    assert_eq!((&report["sequence"], &report["frames"]), (&sequence.name.into(), &8.into()));
    assert!(report["inside"].is_null(), "nothing was pushed out: {report}");
    let farthest = |out: &str| {
        let worn = Mesh::load(at(&format!("{out}/frame-00003.ply"))).unwrap().vertices;
        let captured = sequence.clothing.index_axis(Axis(0), 3);
        let gap = |(v, point): (usize, &[f32; 3])| {
            let squares = (0..3).map(|k| (f64::from(point[k]) - captured[(v, k)]).powi(2));
            squares.sum::<f64>().sqrt()
        };
        worn.iter().enumerate().map(gap).fold(0.0, f64::max)
    };
    assert!(farthest("same") < 1e-5, "{}", farthest("same"));
    // A larger body stretches it and has nothing of it inside.
    let report = transfer("--betas 2,2", "large").json();
    assert!(farthest("large") > 0.01);
    assert!(report["inside"]["after"].as_f64().unwrap() < 1e-3, "{report}");
    transfer("--sequence anna", "none").failed_saying(&["`anna`", "march"]);
}

#[test]
fn a_skirt_is_learned_and_predicted() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    let (set, learned, predicted) = (skirt().display(), at("learned"), at("predicted"));
    let report =
        run_line(&format!("layer learn {set} --components 3 --out {learned} --json")).json();
    let errors = report["reconstruction"][0]["errors"].as_array().unwrap();
    let means: Vec<f64> = errors.iter().map(|e| e["mean_mm"].as_f64().unwrap()).collect();
    assert!(means.windows(2).all(|pair| pair[1] <= pair[0]), "{means:?}");
    assert!(*means.last().unwrap() < 1e-3, "{means:?}");
    let clothing = Mesh::load(format!("{learned}/clothing.ply")).unwrap();

    let layer = format!("{learned}/layer.npz");
    let named = "--parameters length=0.9,friction=0.2";
    let line = format!("layer predict {layer} --seconds 0.1 --out {predicted} --json {named}");
    let report = run_line(&line).json();
    assert_eq!(report["parameters"][0], serde_json::json!(["length", 0.9]));
    let frame = Mesh::load(format!("{predicted}/frame-00002.ply")).unwrap();
    assert_eq!(frame.vertices.len(), clothing.vertices.len());
    assert_eq!(fs::read_dir(&predicted).unwrap().count(), 4, "three frames and a picture");

    run_line(&format!("layer predict {layer} --out {predicted}"))
        .failed_saying(&["already exists"]);
    run_line(&format!("layer predict {layer} --parameters collar=1 --out {}", at("other")))
        .failed_saying(&["`collar`", "length"]);
    run_line(&format!("layer predict {layer} --random 2 --out {}", at("other")))
        .failed_saying(&["no other parameters", "differed"]);
    run_line(&format!("layer learn {learned} --out {}", at("other"))).failed_saying(&["learned"]);
    run_line(&format!("layer learn {set} --components 40 --out {}", at("other")))
        .failed_saying(&["40 principal components of 5 frames", "expected 1 to 4"]);

    // The same motion from an archive, from rows of text, and from rows as they arrive.
    let sequence = &LayerSet::load(skirt()).unwrap().sequences[0];
    let motion = &sequence.motion;
    let rows = motion.poses.rows().into_iter().zip(motion.translations.rows());
    let text: String = rows
        .map(|(pose, transl)| {
            let numbers = pose.iter().chain(transl).map(|x| (*x as f32).to_string());
            numbers.collect::<Vec<_>>().join(",") + "\n"
        })
        .collect();
    fs::write(at("rows.csv"), &text).unwrap();
    let archive = skirt().join(format!("{}.npz", sequence.name)).display().to_string();
    // Clothing where it is predicted: what is pushed out goes to the nearest face, which may change.
    let of = |motion: &str, out: &str| {
        let options = "--format obj --clearance 0";
        format!("layer predict {layer} --motion {motion} {options} --out {}", at(out))
    };
    run_line(&of(&at("rows.csv"), "rows")).succeeded();
    run_line(&of(&archive, "archive")).succeeded();
    let mut child = cape(of("-", "stream").split_whitespace())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
    let output: Output = child.wait_with_output().unwrap();
    Ran::from(output).succeeded();
    for frame in 0..sequence.frames() {
        let read = |from: &str| fs::read(format!("{}/frame-{frame:05}.obj", at(from))).unwrap();
        assert_eq!(read("rows"), read("stream"));
        let [one, other] = ["rows", "archive"]
            .map(|from| Mesh::load(format!("{}/frame-{frame:05}.obj", at(from))).unwrap());
        for (p, q) in one.vertices.iter().zip(&other.vertices) {
            assert!(p.iter().zip(q).all(|(a, b)| (a - b).abs() < 1e-4), "{p:?} {q:?}");
        }
    }
    fs::write(at("bad.csv"), "1,2,3\n").unwrap();
    run_line(&of(&at("bad.csv"), "bad")).failed_saying(&["bad.csv", "no poses found", "[1, 3]"]);
}

#[test]
fn an_association_is_shown() {
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("tied").display().to_string();
    let options = "--compare 1,32 --sigma 50 --support 150";
    let line = format!("layer associate {} {options} --out {out} --json", skirt().display());
    let report = run_line(&line).json();
    assert!(report["pairs"].as_u64().unwrap() > 50, "{report}");
    // At seams, which few edges cross, more body vertices tear the cloth less.
    for measure in ["percentile_99", "largest_change"] {
        let change = |k: usize| report["seams"][k][measure].as_f64().unwrap();
        assert!(change(1) < 0.75 * change(0), "{measure}: {report}");
    }
    for name in ["association.png", "seams.png", "body.ply", "clothing.ply", "association.json"] {
        assert!(fs::metadata(format!("{out}/{name}")).unwrap().len() > 0, "{name}");
    }
}

#[test]
fn sequences_are_imported_and_odd_ones_told() {
    let place = tempfile::tempdir().unwrap();
    let set = place.path().join("own");
    let plain = captured(|_, _| {});
    let report = import(&plain, &set, "walk").json();
    assert_eq!((&report["frames"], &report["sequences"]), (&8.into(), &1.into()));
    let back = LayerSet::load(&set).unwrap();
    let known = LayerSet::load(skirt()).unwrap();
    assert_eq!(back.sequences[0].clothing, known.sequences[0].clothing);
    import(&plain, &set, "walk").failed_saying(&["--name walk"]);

    let flipped = captured(|_, mesh| mesh.faces.iter_mut().for_each(|f| f.swap(1, 2)));
    import(&flipped, &set, "flipped").failed_saying(&["same topology"]);
    let alone = place.path().join("flipped");
    let said = import(&flipped, &alone, "flipped");
    assert!(said.err.contains("faces are flipped"), "{}", said.err);
    said.succeeded();

    let other = captured(|_, mesh| mesh.faces.truncate(100));
    import(&other, &set, "other").failed_saying(&["same topology"]);
    let ragged = captured(|frame, mesh| mesh.faces.truncate(100 + frame));
    import(&ragged, &alone, "ragged").failed_saying(&["0001.ply", "other faces"]);
    let late = captured(|_, _| {});
    fs::remove_file(late.path().join("meshes/0003.ply")).unwrap();
    import(&late, &set, "late").failed_saying(&["out of step"]);
    let broken = captured(|frame, mesh| {
        if frame == 2 {
            mesh.vertices[5][1] = f32::NAN;
        }
    });
    import(&broken, &set, "broken").failed_saying(&["not"]);
    let away = captured(|_, mesh| mesh.vertices.iter_mut().for_each(|v| v[0] += 3.0));
    import(&away, &set, "away").failed_saying(&["none of", "rays"]);
    // Drawn in towards the middle of the trunk.
    let middle = known.sequences[0].clothing.index_axis(Axis(0), 0).mean_axis(Axis(0)).unwrap();
    let sunk = captured(|_, mesh| {
        for v in &mut mesh.vertices {
            for k in [0, 2] {
                v[k] = middle[k] as f32 + 0.2 * (v[k] - middle[k] as f32);
            }
        }
    });
    let sunk = import(&sunk, &place.path().join("sunk"), "sunk");
    assert!(sunk.err.contains("out of the body"), "{}", sunk.err);
    assert_eq!(LayerSet::load(&set).unwrap().sequences.len(), 1);
}

#[test]
fn sequences_of_other_programs_are_imported() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    let known = LayerSet::load(skirt()).unwrap();
    let frames = known.frames();
    let expected = &known.sequences[0];
    // Centimetres with z up, without leading zeros, beside other meshes and hidden files.
    let turned = |[x, y, z]: [f32; 3]| [100.0 * x, -100.0 * z, 100.0 * y];
    let meshes = place.path().join("frames");
    fs::create_dir(&meshes).unwrap();
    let points = known.sequences[0].clothing.dim().1;
    let mut cache =
        PointCacheWriter::create(at("skirt.pc2"), PointCacheFormat::Pc2, [frames, points], 30.0)
            .unwrap();
    for frame in 0..frames {
        let mut mesh = known.clothing(0, frame).unwrap().to_mesh();
        mesh.vertices.iter_mut().for_each(|vertex| *vertex = turned(*vertex));
        mesh.save(meshes.join(format!("{}_skirt.obj", frame + 3))).unwrap();
        fs::write(meshes.join(format!("._{}_skirt.obj", frame + 3)), b"\0\x05\x16\x07").unwrap();
        fs::write(meshes.join(format!("{}_body.obj", frame + 3)), "v 0 0 0\n").unwrap();
        cache.push(&mesh.vertices).unwrap();
        if frame == 0 {
            mesh.save(at("skirt.obj")).unwrap();
        }
    }
    cache.finish().unwrap();
    // The body lies in these coordinates: its root is turned about the pelvis.
    let model = embedded_body(Gender::Neutral).unwrap();
    let pelvis = model.rest_joints(&model.rest_shape(&expected.betas).unwrap()).unwrap();
    let pelvis = [0, 1, 2].map(|axis| pelvis[(0, axis)]);
    let mut lying = expected.motion.clone();
    // Three quarters of a turn from z to y are a quarter back.
    for _ in 0..3 {
        lying = lying.turned_upright(UpAxis::Z, pelvis);
    }
    let mut file = NpzWriter::create(at("motion.npz")).unwrap();
    file.add("poses", &lying.poses).unwrap();
    file.add("trans", &lying.translations).unwrap();
    file.add("betas", &ndarray::Array1::from(expected.betas.clone())).unwrap();
    file.add("mocap_framerate", &ndarray::arr0(30.0)).unwrap();
    file.finish().unwrap();
    for (name, source) in [
        (
            "cache",
            format!("{} {} --topology {}", at("skirt.pc2"), at("motion.npz"), at("skirt.obj")),
        ),
        ("files", format!("{} {} --files *_skirt.obj", at("frames"), at("motion.npz"))),
    ] {
        let set = at(&format!("set-{name}"));
        run_line(&format!("layer import {source} --unit cm --up z --set {set} --name walk --json"))
            .succeeded();
        let found = LayerSet::load(&set).unwrap();
        assert_eq!(found.body.as_ref().unwrap().name, "neutral (built in)");
        let (found, wanted) = (&found.sequences[0], &expected.clothing);
        assert_eq!(found.clothing.dim(), wanted.dim(), "{name}");
        assert!(found.clothing.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-4), "{name}");
        let moved = found.motion.translations.iter().zip(&expected.motion.translations);
        assert!(moved.clone().all(|(a, b)| (a - b).abs() < 1e-9), "{name}");
    }
    // At half the rate, the motion follows.
    let half = at("half");
    run_line(&format!(
        "layer import {} {} --unit cm --up z --resample 15 --set {half} --name walk",
        at("skirt.pc2"),
        at("motion.npz")
    ))
    .succeeded();
    let found = LayerSet::load(&half).unwrap();
    assert_eq!((found.frames(), found.sequences[0].motion.frame_rate), (frames.div_ceil(2), 15.0));
    // In metres the clothing is out of reach; without rate nothing is known of speeds.
    run_line(&format!(
        "layer import {} {} --up z --set {} --name walk",
        at("skirt.pc2"),
        at("motion.npz"),
        at("none")
    ))
    .failed_saying(&["metres"]);

    // Another body is refused.
    let mut other = model.clone();
    other.v_template.mapv_inplace(|x| 1.01 * x);
    other.save(at("other.npz")).unwrap();
    let set = at("set-cache");
    for command in ["learn", "associate"] {
        run_line(&format!("layer {command} {set} --body {} --out {}", at("other.npz"), at("none")))
            .failed_saying(&["another body, `neutral (built in)`", "--body"]);
    }
}

/// Half-precision bits of a number of moderate size, cut off.
fn half(x: f32) -> u16 {
    let bits = x.to_bits();
    let exponent = (bits >> 23 & 0xff) as i32 - 127 + 15;
    let sign = (bits >> 16 & 0x8000) as u16;
    if exponent <= 0 { sign } else { sign | (exponent as u16) << 10 | (bits >> 13 & 0x3ff) as u16 }
}

/// Element of a MATLAB file: an array of numbers by columns, or an empty structure without them.
fn matlab(name: &str, shape: [i32; 2], numbers: Option<Vec<f64>>) -> Vec<u8> {
    let element = |kind: u32, data: &[u8]| -> Vec<u8> {
        let mut bytes = [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
        bytes.extend(data);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    };
    let class = if numbers.is_some() { 6 } else { 2 };
    let numbers = numbers.unwrap_or_default();
    let numbers: Vec<u8> = numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
    let parts = [
        element(6, &[class, 0, 0, 0, 0, 0, 0, 0]),
        element(5, &shape.map(i32::to_le_bytes).concat()),
        element(1, name.as_bytes()),
        element(9, &numbers),
    ];
    element(14, &parts.concat())
}

#[test]
fn garments_of_cloth3d_are_imported() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    let known = LayerSet::load(skirt()).unwrap();
    let sequence = &known.sequences[0];
    let (frames, points, _) = sequence.clothing.dim();
    let body = embedded_body(Gender::Neutral).unwrap();
    let joints = body.rest_joints(&body.rest_shape(&sequence.betas).unwrap()).unwrap();
    // The translation is the place of the pelvis, to which the garment is relative.
    let places = &sequence.motion.translations + &joints.row(0);
    let relative = &sequence.clothing - &places.view().insert_axis(Axis(1));
    let mut cache = b"POINTCACHE2\0".to_vec();
    cache.extend([1, points as u32, 0].iter().flat_map(|x| x.to_le_bytes()));
    cache.extend(1f32.to_le_bytes());
    cache.extend((frames as u32).to_le_bytes());
    cache.extend(relative.iter().flat_map(|&x| half(x as f32).to_le_bytes()));
    fs::write(at("Skirt.pc16"), cache).unwrap();
    known.clothing(0, 0).unwrap().to_mesh().save(at("Skirt.obj")).unwrap();
    let mut info = b"MATLAB 5.0 MAT-file, Platform: posix".to_vec();
    info.resize(124, b' ');
    info.extend([0, 1, b'I', b'M']);
    // Frames are columns, stored one after the other.
    let poses = sequence.motion.poses.iter().copied().collect();
    info.extend(matlab("poses", [72, frames as i32], Some(poses)));
    info.extend(matlab("trans", [3, frames as i32], Some(places.iter().copied().collect())));
    let mut betas = sequence.betas.clone();
    betas.resize(10, 0.0);
    info.extend(matlab("shape", [1, 10], Some(betas)));
    info.extend(matlab("zrot", [1, 1], Some(vec![0.4])));
    info.extend(matlab("outfit", [1, 1], None));
    fs::write(at("info.mat"), info).unwrap();
    let import = |rest: &str| {
        let files = [at("Skirt.pc16"), at("info.mat")].join(" ");
        run_line(&format!("layer import {files} --fps 30 --set {} --name walk {rest}", at("set")))
    };
    let ran = import("--up y");
    assert!(ran.err.contains("relative to the pelvis"), "{}", ran.err);
    ran.succeeded();
    let found = &LayerSet::load(at("set")).unwrap().sequences[0];
    // Half precision cuts off a millimetre at two metres.
    assert!(found.clothing.iter().zip(&sequence.clothing).all(|(a, b)| (a - b).abs() < 2e-3));
    let moved = &found.motion.translations - &sequence.motion.translations;
    assert!(moved.iter().all(|x| x.abs() < 1e-9), "{moved}");
}

#[test]
fn simulated_sequences_of_vto_are_imported() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("tshirt_shape00_01_01.pkl");
    let known = LayerSet::load(skirt()).unwrap();
    let sequence = &known.sequences[0];
    let frames = known.frames();
    let list = |numbers: &mut dyn Iterator<Item = f64>| -> String {
        let numbers: Vec<String> = numbers.map(|x| format!("F{x:e}\na")).collect();
        format!("(l{}", numbers.concat())
    };
    // Lists of lists stand for the arrays of the published layout.
    let rows = |rows: Vec<String>| {
        let rows: Vec<String> = rows.iter().map(|row| format!("{row}a")).collect();
        format!("(l{}", rows.concat())
    };
    let motion = &sequence.motion;
    let poses = (0..frames).map(|frame| {
        list(&mut motion.poses.row(frame).iter().chain(&motion.translations.row(frame)).copied())
    });
    let shapes = (0..frames).map(|_| list(&mut sequence.betas.iter().copied()));
    let vertices = sequence.clothing.outer_iter().map(|frame| {
        rows(frame.rows().into_iter().map(|row| list(&mut row.iter().copied())).collect())
    });
    let faces = known.faces.iter().map(|face| {
        let corners: Vec<String> = face.iter().map(|corner| format!("I{corner}\na")).collect();
        format!("(l{}", corners.concat())
    });
    let entry = |name: &str, value: String| format!("V{name}\n{value}s");
    let text = format!(
        "(d{}{}{}{}.",
        entry("poses", rows(poses.collect())),
        entry("shapes", rows(shapes.collect())),
        entry("vertices", rows(vertices.collect())),
        entry("faces", rows(faces.collect())),
    );
    fs::write(&path, text).unwrap();
    let set = place.path().join("set").display().to_string();
    run_line(&format!("layer import {} --fps 30 --up y --set {set} --name march", path.display()))
        .succeeded();
    let found = LayerSet::load(&set).unwrap();
    assert_eq!(found.faces, known.faces);
    let found = &found.sequences[0];
    assert!(found.clothing.iter().zip(&sequence.clothing).all(|(a, b)| (a - b).abs() < 1e-6));
    assert!((&found.motion.poses - &motion.poses).iter().all(|x| x.abs() < 1e-9));
    assert!((&found.motion.translations - &motion.translations).iter().all(|x| x.abs() < 1e-9));
}

#[test]
fn a_report_is_written_and_kept() {
    let place = tempfile::tempdir().unwrap();
    let mut body = embedded_body(Gender::Neutral).unwrap();
    let [known_body, larger_body] = ["known.npz", "larger.npz"].map(|name| place.path().join(name));
    body.save(&known_body).unwrap();
    body.v_template.mapv_inplace(|x| 1.03 * x);
    body.save(&larger_body).unwrap();
    // Two marches and a size more, of which one is the other a little larger.
    let known = LayerSet::load(skirt()).unwrap();
    let mut larger = known.sequences[0].clone();
    larger.name = "larger_march".into();
    larger.clothing.mapv_inplace(|x| 1.01 * x);
    larger.parameters[0].1 *= 1.1;
    let set = place.path().join("marches");
    let sequences = vec![known.sequences[0].clone(), larger];
    LayerSet::new(known.faces.clone(), sequences).unwrap().save(&set).unwrap();
    let out = place.path().join("report");
    let line = format!(
        "layer report {} --body {} --components 4 --trainings 2 --out {} --json",
        set.display(),
        known_body.display(),
        out.display()
    );
    let first = run_line(&line);
    let report: serde_json::Value = serde_json::from_str(&first.out).expect(&first.err);
    assert_eq!(report["reconstruction"].as_array().unwrap().len(), 2);
    let lines = report["regression"].as_array().unwrap();
    let of = |factor: &str| lines.iter().filter(|line| line["factor"] == factor).count();
    assert_eq!((of(""), of("fit"), of("shape"), of("motion")), (3, 2, 0, 0));
    for line in lines {
        let [space, predict] = ["space_mm", "predict_mm"].map(|key| line[key].as_f64().unwrap());
        assert!(space <= predict + 1e-9, "{line}");
    }
    let page = fs::read(out.join("report.html")).unwrap();
    assert!(String::from_utf8_lossy(&page).contains("table 2"));
    for name in ["reconstruction.csv", "regression.csv", "new.csv", "marches-fit.png"] {
        assert!(fs::metadata(out.join(name)).unwrap().len() > 0, "{name}");
    }
    let again = run_line(&line);
    assert!(again.err.contains("marches, fit: already done"), "{}", again.err);
    assert_eq!(again.out, first.out);
    assert_eq!(fs::read(out.join("report.html")).unwrap(), page);

    // Results of another body or other settings are not mistaken for these, and stay.
    let results = contents(&out.join("results"));
    run_line(&line.replace("known.npz", "larger.npz")).failed_saying(&[
        "results/marches/settings.json",
        "`inputs.body`",
        "known.npz",
        "larger.npz",
        "--overwrite",
        "--out",
    ]);
    run_line(&format!("{line} --neighbours 2")).failed_saying(&[
        "`settings.association.neighbours`",
        "4",
        "2",
        "--overwrite",
    ]);
    assert!(contents(&out.join("results")) == results);
    let other = run_line(&format!("{line} --neighbours 2 --overwrite"));
    assert!(!other.err.contains("already done"), "{}", other.err);
    other.succeeded();
    let fit = out.join("results/marches/fit.json");
    truncate(&fit);
    run_line(&format!("{line} --neighbours 2"))
        .failed_saying(&["results/marches/fit.json", "remove this file"]);
    fs::remove_file(&fit).unwrap();
    let again = run_line(&format!("{line} --neighbours 2"));
    assert_eq!(again.err.matches("already done").count(), 2, "{}", again.err);
    again.succeeded();

    let foreign = place.path().join("foreign");
    fs::create_dir(&foreign).unwrap();
    fs::write(foreign.join("thesis.tex"), "").unwrap();
    run_line(&format!("layer report {} --overwrite --out {}", set.display(), foreign.display()))
        .failed_saying(&["thesis.tex", "another --out"]);
}

#[test]
fn a_grid_of_sizes_and_materials_is_simulated_and_goes_on() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    let options = "--garment shorts --exercises jump --frames 2 --resolution 50 --steps 10 \
                   --subjects=-1,1 --lengths 1,1.2 --friction 1,2";
    let (whole, halted) = (at("whole"), at("halted"));
    let synth = |out: &str| run_line(&format!("layer synth {options} --out {out} --json"));
    let report = synth(&whole).json();
    assert_eq!((&report["sequences"], &report["simulated_now"]), (&8.into(), &8.into()));
    for simulation in report["simulations"].as_array().unwrap() {
        assert!(simulation["penetration_mm"].as_f64().unwrap() < 5.0, "{simulation}");
        assert!(simulation["strain"].as_f64().unwrap() < 0.35, "{simulation}");
        assert!(simulation["crossings"].is_u64(), "{simulation}");
    }

    // As after an interruption: some are done, one is written but not noted.
    fs::create_dir(&halted).unwrap();
    let copy =
        |name: &str| fs::copy(format!("{whole}/{name}"), format!("{halted}/{name}")).unwrap();
    for file in fs::read_dir(&whole).unwrap() {
        let name = file.unwrap().file_name().into_string().unwrap();
        if !name.starts_with("s01") {
            copy(&name);
        }
    }
    for (name, kept) in [("set.json", 4), ("simulation.json", 3)] {
        let text = fs::read(format!("{whole}/{name}")).unwrap();
        let mut value: serde_json::Value = serde_json::from_slice(&text).unwrap();
        let list = if name == "set.json" { &mut value["sequences"] } else { &mut value };
        list.as_array_mut().unwrap().truncate(kept);
        fs::write(format!("{halted}/{name}"), serde_json::to_vec_pretty(&value).unwrap()).unwrap();
    }
    assert_eq!(synth(&halted).json()["simulated_now"], 5);
    for file in fs::read_dir(&whole).unwrap() {
        let name = file.unwrap().file_name().into_string().unwrap();
        let [one, other] =
            [&whole, &halted].map(|place| fs::read(format!("{place}/{name}")).unwrap());
        assert!(one == other, "{name} differs after an interruption");
    }
    assert_eq!(synth(&halted).json()["simulated_now"], 0);
    random_parameters_are_predicted(&whole, place.path());
    run_line(&format!("layer synth --garment skirt --out {halted}"))
        .failed_saying(&["other settings"]);
    // A directory of the first simulator, whose plan has no version.
    let plan = format!("{halted}/design.json");
    let mut value: serde_json::Value = serde_json::from_slice(&fs::read(&plan).unwrap()).unwrap();
    value.as_object_mut().unwrap().remove("simulator").unwrap();
    fs::write(&plan, serde_json::to_vec(&value).unwrap()).unwrap();
    run_line(&format!("layer synth {options} --out {halted}"))
        .failed_saying(&["version 0 of the simulator", "--out"]);
}

/// Draws of random parameters from a set of two lengths and two frictions.
fn random_parameters_are_predicted(set: &str, place: &Path) {
    let at = |name: &str| place.join(name).display().to_string();
    run_line(&format!("layer learn {set} --components 2 --out {}", at("learned"))).succeeded();
    let layer = at("learned/layer.npz");
    let random = |options: &str, out: &str| {
        let line = format!("layer predict {layer} --seconds 0.1 --random 3 {options}");
        run_line(&format!("{line} --out {} --json", at(out))).json()
    };
    let report = random("--parameters friction=0.4", "random");
    let numbers = |report: &serde_json::Value, draw: usize, name: &str| {
        let named = report["random"][draw]["parameters"].as_array().unwrap();
        named.iter().find(|pair| pair[0] == name).unwrap()[1].as_f64().unwrap()
    };
    assert_eq!((&report["frames"], report["random"].as_array().unwrap().len()), (&3.into(), 3));
    let lengths = [0, 1, 2].map(|draw| numbers(&report, draw, "length"));
    assert!(lengths[0] != lengths[1] && lengths[1] != lengths[2], "{lengths:?}");
    for draw in 0..3 {
        assert_eq!(numbers(&report, draw, "friction"), 0.4);
        assert_eq!(numbers(&report, draw, "width"), numbers(&report, 0, "width"), "is constant");
        assert_eq!(numbers(&report, draw, "beta_1"), 0.0, "is the wearer's");
    }
    let file = fs::read(at("random/random.json")).unwrap();
    assert_eq!(serde_json::from_slice::<serde_json::Value>(&file).unwrap(), report["random"]);
    assert!(fs::metadata(at("random/random.png")).unwrap().len() > 0);
    let mesh = |out: &str, draw: usize| {
        fs::read(at(&format!("{out}/random-{draw}/frame-00002.ply"))).unwrap()
    };
    assert_ne!(mesh("random", 1), mesh("random", 2));
    let options = "--components 2 --wearer-ratios";
    run_line(&format!("layer learn {set} {options} --out {}", at("ratios"))).succeeded();
    let of_ratios = |named: &str, out: &str| {
        let layer = at("ratios/layer.npz");
        run_line(&format!(
            "layer predict {layer} --parameters {named} --seconds 0.1 --out {}",
            at(out)
        ))
    };
    of_ratios("length=1", "cut").failed_saying(&["`length`", "length_ratio, width_ratio"]);
    of_ratios("length_ratio=1", "worn").succeeded();
    random("--parameters friction=0.4", "again");
    assert_eq!(mesh("random", 3), mesh("again", 3));
    random("--parameters friction=0.4 --seed 5", "others");
    assert_ne!(mesh("random", 3), mesh("others", 3));
}

#[test]
fn clothing_may_include_the_body() {
    let place = tempfile::tempdir().unwrap();
    let set = place.path().join("set").display().to_string();
    let options = "--garment tshirt --exercises squat --frames 2 --resolution 50 --steps 10";
    let report = run_line(&format!("layer synth {options} --with-body --out {set} --json")).json();
    let set = cape::layer::LayerSet::load(&set).unwrap();
    assert!(set.vertices() > 6890);
    assert_eq!(report["vertices"], set.vertices());
    assert!(set.faces.iter().flatten().any(|&v| v as usize == set.vertices() - 1));

    let bad = format!("layer synth --widths 0.5 --out {}", place.path().join("bad").display());
    run_line(&bad).failed_saying(&["width"]);
}
