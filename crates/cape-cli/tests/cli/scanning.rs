//! Clothed bodies from scans, codes of registrations, and clothes on other bodies.

use std::fs;

use cape::core::{Mesh, geometry::primitives::grid, npy::write_npy, ply};
use glam::DVec3;
use ndarray::Array2;

use crate::support::{Packed, pose_of, small_body, trained, truncate};

/// The small body's surface, posed and a little wider, as points between its vertices.
fn scan(scale: f32) -> Mesh {
    let body = small_body();
    let worn = 0.05 * &body.v_template;
    let pose = pose_of(3).map(|angle| 0.3 * angle);
    let posed = body.pose(&[], &pose, [0.2, 1.0, 0.1], Some(&worn)).unwrap();
    let mesh = body.mesh_with(&posed.vertices);
    let mut points = Vec::new();
    for &face in &mesh.faces {
        let [a, b, c] = mesh.corners(face).unwrap();
        for (u, v) in [(0.2, 0.2), (0.2, 0.6), (0.6, 0.2)] {
            points.push(((a + (b - a) * u + (c - a) * v) * scale).to_array());
        }
    }
    Mesh { vertices: points, faces: Vec::new() }
}

#[test]
fn a_scan_becomes_a_registration_that_is_packed() {
    let (data, run) = (Packed::new(), trained().at("run").display().to_string());
    ply::write(data.at("scan.ply"), &scan(1000.0), None).unwrap();
    let fit = |out: &str| {
        let options = "--unit mm --outfit longlong --pose t-pose --free-displacement --json";
        data.run(&format!("fit scan {run} --scan @/scan.ply {options} --out @/{out}"))
    };
    let report = fit("fitted").json();
    assert!(report["fit"]["distance"]["median"].as_f64().unwrap() < 12.0, "{report}");
    let before = report["fit"]["distance"]["mean"].as_f64().unwrap();
    assert!(report["free"]["distance"]["mean"].as_f64().unwrap() < before, "{report}");
    for name in ["bare.ply", "clothed.ply", "displaced.ply", "clothed.glb", "fit.png", "code.npy"] {
        assert!(data.at("fitted").join(name).exists(), "{name}");
    }
    // What was found is a start, and the same again is the same.
    let sure = "--initial @/fitted/fit.json --minimal-shape @/fitted/minimal.npy --outfit longlong";
    data.run(&format!("fit scan {run} --scan @/scan.ply --unit mm {sure} --out @/more"))
        .succeeded();
    fit("again").succeeded();
    for name in ["clothed.ply", "displaced.ply", "fit.png"] {
        let [a, b] = ["fitted", "again"].map(|out| fs::read(data.at(out).join(name)).unwrap());
        assert!(a == b, "{name}");
    }
    let packed = data.run("data pack @/fitted/raw --out @/packed-scan --json").json();
    assert_eq!(packed["train_frames"], 1, "{packed}");
}

#[test]
fn scans_that_are_none_are_refused() {
    let (data, run) = (Packed::new(), trained().at("run").display().to_string());
    ply::write(data.at("mm.ply"), &scan(1000.0), None).unwrap();
    ply::write(data.at("m.ply"), &scan(1.0), None).unwrap();
    let few = Mesh { vertices: scan(1.0).vertices[..20].to_vec(), faces: Vec::new() };
    ply::write(data.at("few.ply"), &few, None).unwrap();
    ply::write(data.at("cut.ply"), &scan(1.0), None).unwrap();
    truncate(&data.at("cut.ply"));
    fs::write(data.at("nan.obj"), "v 0 nan 0\n").unwrap();
    fs::write(data.at("scan.txt"), "1 2 3\n").unwrap();
    let fit = |scan: &str, options: &str| {
        data.run(&format!("fit scan {run} --scan @/{scan} --outfit longlong {options} --out @/no"))
    };
    fit("mm.ply", "").failed_saying(&["mm.ply", "--unit mm"]);
    fit("few.ply", "").failed_saying(&["few.ply", "20 points"]);
    fit("cut.ply", "").failed_saying(&["cut.ply"]);
    fit("nan.obj", "").failed_saying(&["nan.obj", "1 points"]);
    fit("scan.txt", "").failed_saying(&[".obj, .ply, .stl, .off or .glb"]);
    fit("lost.ply", "").failed_saying(&["lost.ply"]);
    fit("m.ply", "--pose headstand").failed_saying(&["headstand"]);
    fs::write(data.at("joints.json"), "[[0,0,0]]").unwrap();
    fit("m.ply", "--joints @/joints.json").failed_saying(&["joints.json", "24"]);
    write_npy(data.at("other.npy"), &Array2::<f64>::zeros((5, 3))).unwrap();
    fit("m.ply", "--minimal-shape @/other.npy").failed_saying(&["other.npy", "[5, 3]"]);
    assert!(!data.at("no").exists());
}

#[test]
fn a_garment_is_laid_onto_scans_of_other_triangles() {
    let data = Packed::new();
    // A sheet of 60 cm with bumps that rolls up, in millimetres; each scan has a topology of its own.
    let bent = |u: f64, v: f64, frame: usize| {
        let angle = 0.001 + 0.15 * frame as f64;
        let radius = 1.0 / angle;
        let (along, up) = (angle * u).sin_cos();
        let bump = 0.04 * (8.0 * u).sin() * (9.0 * v).cos();
        let rolled = DVec3::new(radius * along, v, radius * (1.0 - up));
        600.0 * (rolled + bump * DVec3::new(-along, 0.0, up))
    };
    let template = grid(13, 13, |u, v| bent(u, v, 0));
    template.to_mesh().save(data.at("sheet.obj")).unwrap();
    fs::create_dir(data.at("frames")).unwrap();
    for frame in 0..8 {
        let scanned = grid(30 + frame, 25, |u, v| bent(u, v, frame)).to_mesh();
        scanned.save(data.at(&format!("frames/scan{}.ply", 8 + frame))).unwrap();
    }
    let register = |out: &str| {
        let scans = "--garment @/sheet.obj --scan @/frames --unit mm --json";
        data.run(&format!("fit scan {scans} --out @/{out}"))
    };
    let report = register("tracked").json();
    let frames = report["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 8, "{report}");
    for (frame, entry) in frames.iter().enumerate() {
        // In natural order: scan9 comes before scan10.
        let name = format!("scan{}.ply", 8 + frame);
        assert!(entry["scan"].as_str().unwrap().ends_with(&name), "{entry}");
        let found = Mesh::load(data.at("tracked").join(&name)).unwrap();
        assert_eq!(found.faces, template.faces);
        let truth = grid(13, 13, |u, v| bent(u, v, frame) / 1000.0).vertices;
        let off = |(a, b): (&[f32; 3], &DVec3)| glam::Vec3::from(*a).as_dvec3().distance(*b);
        let mean = found.vertices.iter().zip(&truth).map(off).sum::<f64>() / truth.len() as f64;
        assert!(mean < 0.005, "frame {frame}: {mean}");
    }
    assert!(data.at("tracked/garment.png").exists() && data.at("tracked/garment.json").exists());
    register("again").succeeded();
    let [a, b] = ["tracked", "again"].map(|out| fs::read(data.at(out).join("scan15.ply")).unwrap());
    assert!(a == b);
    let refused = |words: &str| data.run(&format!("fit scan {words} --out @/no"));
    let frames = "--scan @/frames";
    refused(&format!("--garment @/sheet.obj {frames} --unit auto")).failed_saying(&["--unit auto"]);
    refused(&format!("--garment @/lost.obj {frames}")).failed_saying(&["lost.obj"]);
    refused(&format!("--garment @/sheet.obj {frames} --outfit longlong")).misused(&["--outfit"]);
    let mut away = template.clone();
    away.vertices.iter_mut().for_each(|vertex| vertex.x += 5000.0);
    away.to_mesh().save(data.at("away.obj")).unwrap();
    refused(&format!("--garment @/away.obj {frames} --unit mm"))
        .failed_saying(&["scan8.ply", "no point of the scan"]);
    fs::create_dir(data.at("empty")).unwrap();
    refused("--garment @/sheet.obj --scan @/empty").failed_saying(&["empty", "no scans"]);
    fs::copy(data.at("frames/scan8.ply"), data.at("frames/scan8.obj")).unwrap();
    refused(&format!("--garment @/sheet.obj {frames} --unit mm")).failed_saying(&["two scans"]);
}

#[test]
fn scans_of_held_out_bodies_are_measured() {
    let (data, run) = (Packed::new(), trained().at("run").display().to_string());
    let options = "--frames 1 --points 600 --noise 0,5 --holes 0.2 --json";
    let report = data.run(&format!("fit benchmark scan {run} {options} --out @/scans")).json();
    assert_eq!(report["cases"].as_array().unwrap().len(), 2, "{report}");
    assert!(report["levels"][1]["error"]["clothed"].as_f64().unwrap() > 0.0);
    // Finished scans are kept, and other levels may be added.
    let more = options.replace("--noise 0,5", "--noise 5,8");
    let more = data.run(&format!("fit benchmark scan {run} {more} --out @/scans")).json();
    assert_eq!(more["levels"][0], report["levels"][1]);
    data.run(&format!("fit benchmark scan {run} --points 500 --out @/scans")).failed_saying(&[
        "`settings.points`",
        "600",
        "500",
        "--overwrite",
    ]);
    data.run(&format!("fit benchmark scan {run} --holes 2 --out @/no")).misused(&["--holes"]);
    data.run(&format!("fit benchmark scan {run} --holes 0.95 --out @/no"))
        .failed_saying(&["--holes"]);
}

#[test]
fn registrations_are_encoded_and_given_to_others() {
    let (data, run) = (Packed::new(), trained().at("run").display().to_string());
    let frame = "@/raw/sequences/ann/longlong_walk/longlong_walk.000003.npz";
    let line = format!("model encode {run} {frame} frame:1 --decode --out @/codes --json");
    let report = data.run(&line).json();
    let encoded = report["encoded"].as_array().unwrap();
    assert_eq!(encoded.len(), 2, "{report}");
    assert!(encoded[0]["mesh"].as_str().is_some_and(|name| data.at("codes").join(name).exists()));
    let redressed = data.run(&format!("redress {run} {frame} --out @/same --json")).json();
    assert_eq!(redressed["code"], encoded[0]["code"]);
    assert_eq!(redressed["error_mm"], encoded[0]["error_mm"]);
    let sampled = "--by outfit --codes @/codes/codes.npy:1";
    data.run(&format!("vary {run} {sampled} --out @/varied")).succeeded();

    let mut wider = small_body().v_template;
    wider.column_mut(0).mapv_inplace(|x| 1.2 * x);
    write_npy(data.at("wide.npy"), &wider).unwrap();
    let to = "--to 1,-0.5 --to @/wide.npy --to frame:2";
    for exact in ["", "--exact"] {
        let out = format!("@/given{exact}");
        let line = format!("redress {run} {frame} {to} {exact} --out {out} --json");
        let report = data.run(&line).json();
        let given = report["transferred"].as_array().unwrap();
        assert_eq!(given.len(), 3, "{report}");
        for one in given {
            assert!(one["stretch"].as_f64().unwrap() >= 0.0, "{one}");
            assert!((0.0..=1.0).contains(&one["inside"].as_f64().unwrap()), "{one}");
        }
        assert!(given[1]["stretch"].as_f64().unwrap() > 0.01, "{report}");
    }
    let no = |to: &str| data.run(&format!("redress {run} {frame} --to {to} --out @/no"));
    no("1,2,3,4").failed_saying(&["betas"]);
    no("@/lost.npy").failed_saying(&["lost.npy"]);
}

#[test]
fn scans_with_broken_points_and_of_any_unit_are_fitted() {
    let (data, run) = (Packed::new(), trained().at("run").display().to_string());
    let fit = |scan: &str, options: &str, out: &str| {
        let options = format!("--outfit longlong --pose t-pose --json {options} --out @/{out}");
        data.run(&format!("fit scan {run} --scan @/{scan} {options}"))
    };
    let mut broken = scan(1.0);
    broken.vertices[17] = [f32::NAN; 3];
    ply::write(data.at("nan.ply"), &broken, None).unwrap();
    // As programs of Windows print them.
    let rows = broken.vertices.iter().map(|[x, y, z]| format!("v {x} {y} {z}\r\n"));
    let rows = rows.collect::<Vec<_>>().concat().replace("NaN", "-nan(ind)");
    fs::write(data.at("nan.obj"), rows).unwrap();
    let [first, second] = ["nan.ply", "nan.obj"].map(|name| {
        let ran = fit(name, "", &name.replace('.', "-"));
        assert!(ran.err.contains("1 points of the scan are not finite"), "{}", ran.err);
        ran.json()
    });
    assert_eq!(first["removed"], serde_json::json!({"points": 1, "faces": 0}));
    assert_eq!(first["fit"], second["fit"]);
    for vertex in &mut broken.vertices[100..400] {
        vertex[1] = f32::NAN;
    }
    ply::write(data.at("many.ply"), &broken, None).unwrap();
    fit("many.ply", "", "many").failed_saying(&["many.ply", "not finite", "at most 5 %"]);

    // Scaled to unit size.
    let whole = scan(1.0);
    let [low, high] = whole.bounding_box().unwrap();
    let size = (0..3).map(|axis| high[axis] - low[axis]).fold(0f32, f32::max);
    ply::write(data.at("unit.ply"), &scan(1.0 / size), None).unwrap();
    let said = fit("unit.ply", "", "unit");
    assert!(said.err.contains("exactly 1 m in extent") && said.err.contains("--unit auto"));
    let found = fit("unit.ply", "--unit auto", "auto");
    assert!(found.err.contains("scaled to 1.7 m"), "{}", found.err);
    assert!((found.json()["scale"].as_f64().unwrap() - 1.7).abs() < 1e-9);
}
