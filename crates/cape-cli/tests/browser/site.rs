//! The folder of `cape view --export`.

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    net::{TcpListener, TcpStream},
    path::{Path, PathBuf},
    sync::OnceLock,
    thread,
};

use cape::{
    core::{Mesh, Outfit, gltf::GltfFile, obj},
    data::Split,
    infer::{BodySpec, GarmentColours, Run, registration},
    prelude::Device,
};
use glam::Vec3;
use ndarray::Array2;
use serde_json::Value;
use tempfile::TempDir;

use crate::{
    browser::{Browser, Scheme, View},
    devtools::Live,
    firefox::FirefoxPage,
    keep, keep_file,
    support::{Packed, VERTICES, cape, trained},
    viewer::{WIDE, click, difference, set},
};

/// Largest error relative to the norm.
const MOST: f64 = 1e-4;

/// The folder of the built-in model.
fn site() -> &'static Path {
    static SITE: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let make = || {
        let place = tempfile::tempdir().unwrap();
        let site = place.path().join("site");
        let done = cape(["view", "--export"]).arg(&site).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        (place, site)
    };
    &SITE.get_or_init(make).1
}

fn file_url(site: &Path) -> String {
    format!("file://{}/index.html", site.display())
}

/// A file server, and its address.
fn serve(site: &Path) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/", listener.local_addr().unwrap());
    let site = site.to_owned();
    thread::spawn(move || {
        for stream in listener.incoming() {
            let site = site.clone();
            // A browser that has gone does not read.
            thread::spawn(move || stream.map(|stream| answer(stream, &site)));
        }
    });
    address
}

fn answer(mut stream: TcpStream, site: &Path) -> std::io::Result<()> {
    let mut request = String::new();
    let mut reader = BufReader::new(stream.try_clone()?);
    reader.read_line(&mut request)?;
    for line in reader.lines() {
        if line?.is_empty() {
            break;
        }
    }
    let name = request.split(' ').nth(1).unwrap_or_default().trim_start_matches('/');
    let name = if name.is_empty() { "index.html" } else { name };
    let kind = match name.rsplit_once('.') {
        Some((_, "html")) => "text/html",
        Some((_, "css")) => "text/css",
        _ => "text/javascript",
    };
    match fs::read(site.join(name)) {
        Ok(body) => {
            write!(
                stream,
                "HTTP/1.1 200 OK\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
                body.len()
            )?;
            stream.write_all(&body)
        }
        Err(_) => stream.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n"),
    }
}

fn numbers(value: &Value) -> Vec<f32> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap() as f32).collect()
}

/// Error of `found` relative to the norm of `expected`.
fn relative_error(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let squared = |values: &mut dyn Iterator<Item = f32>| -> f64 {
        values.map(|x| f64::from(x).powi(2)).sum()
    };
    let difference = squared(&mut found.iter().zip(expected).map(|(a, b)| a - b));
    (difference / squared(&mut expected.iter().copied())).sqrt()
}

/// Compares the clothed body of a page with the model's; returns the errors of displacement lengths and
/// of vertices.
fn check(run: &Run, state: &Value, layers: &Value) -> [f64; 2] {
    let z = numbers(&state["z"]);
    let outfit: Outfit = state["outfit"].as_str().unwrap().parse().unwrap();
    let body = BodySpec {
        betas: numbers(&state["betas"]),
        pose: numbers(&state["pose"]).try_into().unwrap(),
        outfit,
    };
    let code = Array2::from_shape_vec((1, z.len()), z).unwrap();
    let dressed = run.dress_with_displacements(&code, &[body]).unwrap().remove(0);
    let layers = layers.as_array().unwrap();
    let layer = layers.iter().find(|layer| layer["kind"] == "clothed").unwrap();
    let displacement = dressed.displacement.view();
    let lengths: Vec<f32> = displacement
        .rows()
        .into_iter()
        .zip(run.mask().covered())
        .map(|(row, &covered)| if covered { row.dot(&row).sqrt() } else { 0.0 })
        .collect();
    let errors = [
        relative_error(&numbers(&layer["displacement"]), &lengths),
        relative_error(&numbers(&layer["positions"]), dressed.mesh.vertices.as_flattened()),
    ];
    assert!(errors.iter().all(|&error| error < MOST), "{errors:?} at {state}");

    let colours = GarmentColours::new(run.body(), run.mask()).of(displacement, outfit);
    let colours = colours.iter().flat_map(|rgb| rgb.map(|x| 255.0 * x));
    let found = numbers(&layer["colours"]);
    let found = found.chunks(4).flat_map(|rgba| rgba[..3].to_vec());
    let wrong = found.zip(colours).filter(|(a, b)| (a - b).abs() > 3.0).count();
    assert!(wrong * 1000 < 3 * run.body().vertices(), "{wrong} colours differ");
    errors
}

#[test]
fn a_folder_opened_as_a_file_dresses_bodies_as_the_program_does() {
    let Some(browser) = Browser::find() else { return };
    let run = cape_weights::pretrained(&Device::default()).unwrap();
    let mut live = Live::open(&browser, &file_url(site()), WIDE);
    let start = live.evaluate("cape.ready.then(() => performance.now())");
    println!("ready after {start} ms");
    live.evaluate("cape.settled()");
    let first = live.screenshot();
    keep("site", &first);
    let mut most = [0.0; 2];
    let mut compare = |live: &mut Live| {
        let [state, layers] = ["cape.state()", "cape.layers()"].map(|what| live.evaluate(what));
        let errors = check(&run, &state, &layers);
        most = [0, 1].map(|i| f64::max(most[i], errors[i]));
    };
    compare(&mut live);
    let strongest = live.evaluate("document.querySelector('input[type=range][id^=\"z-\"]').id");
    set(&mut live, &format!("#{}", strongest.as_str().unwrap()), "2.5");
    assert!(difference(&first, &live.screenshot()) > 0.001, "the slider changes nothing");
    compare(&mut live);
    set(&mut live, "#beta-0", "-2");
    let before = live.evaluate("cape.state()");
    click(&mut live, "#outfit-shortshort");
    let z = numbers(&before["z"]);
    let code = Array2::from_shape_vec((1, z.len()), z).unwrap();
    let from: Outfit = before["outfit"].as_str().unwrap().parse().unwrap();
    let prior = run.prior().unwrap().unwrap();
    let moved = prior.transport_codes(&code, from, Outfit::SHORT_SHORT).unwrap();
    let found = numbers(&live.evaluate("cape.state().z"));
    assert!(relative_error(&found, &moved.row(0).to_vec()) < 1e-5, "{found:?} {moved}");
    set(&mut live, "#pose", "squats");
    compare(&mut live);
    set(&mut live, "#seed", "11");
    compare(&mut live);
    let sampled = prior.sample(Outfit::SHORT_SHORT, 1, 1.0, 11);
    let found = numbers(&live.evaluate("cape.state().z"));
    assert!(relative_error(&found, &sampled.row(0).to_vec()) < 1e-6, "{found:?} {sampled}");
    set(&mut live, "#prior", "normal");
    set(&mut live, "#seed", "4294967295");
    let found = numbers(&live.evaluate("cape.state().z"));
    let sampled = run.sample_codes(1, 4_294_967_295);
    assert!(relative_error(&found, &sampled.row(0).to_vec()) < 1e-6, "{found:?} {sampled}");
    set(&mut live, "#motion", "walk_march");
    set(&mut live, "#scrub", "11");
    compare(&mut live);
    keep("site-moved", &live.screenshot());
    println!("displacements {:.1e}, vertices {:.1e}", most[0], most[1]);

    let times = live.evaluate(
        "(async () => { const times = []; for (let i = 0; i < 10; i++) { \
         const slider = document.querySelector('#z-0'); slider.value = i / 10; \
         slider.dispatchEvent(new Event('input')); await cape.settled(); \
         times.push(cape.state().latency); } return times; })()",
    );
    println!("answers after {times} ms");
    assert_eq!(live.complaints(), [""; 0]);
    for url in live.requests() {
        let here = ["file://", "blob:", "data:"].iter().any(|start| url.starts_with(start));
        assert!(here, "{url} was asked for");
    }
}

#[test]
fn files_of_a_folder_on_a_server_parse() {
    let Some(browser) = Browser::find() else { return };
    let address = serve(site());
    let mut live = Live::open(&browser, &address, WIDE);
    live.evaluate("cape.ready");
    live.evaluate("cape.settled()");
    for format in ["obj", "ply", "glb", "png"] {
        click(&mut live, &format!("#download-{format}"));
    }
    let layers = live.evaluate("cape.layers()");
    let positions = numbers(&layers[0]["positions"]);
    let [obj, ply, glb, _] = ["obj", "ply", "glb", "png"].map(|end| live.download(end));
    let meshes = [obj::read(&obj).unwrap().mesh, Mesh::load(&ply).unwrap()];
    for mesh in &meshes {
        assert_eq!(mesh.vertices.as_flattened(), positions);
        assert_eq!(mesh.faces, meshes[0].faces);
    }
    keep_file("site.glb", &glb);
    // Skinned by its skeleton.
    let file = GltfFile::parse(&glb, fs::read(&glb).unwrap()).unwrap();
    let posed = file.vertices(None).unwrap();
    let error = relative_error(posed.as_flattened(), &positions);
    assert!(error < 1e-5, "{error}");
    assert_eq!(file.faces().unwrap(), meshes[0].faces);
    let bytes = fs::read(&glb).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let document: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    assert_eq!(document["skins"][0]["joints"].as_array().unwrap().len(), 24);
    assert_eq!(document["nodes"][16]["name"], "l_shoulder");
    live.evaluate("document.querySelector('#help-open').click()");
    let help = live.evaluate("document.querySelector('#help-notes').textContent");
    assert!(help.as_str().unwrap().contains("registrations"), "{help}");
    keep("site-help", &live.screenshot());
    assert_eq!(live.complaints(), [""; 0]);
    for url in live.requests() {
        let here = [&address[..], "blob:", "data:"].iter().any(|start| url.starts_with(start));
        assert!(here, "{url} was asked for");
    }
}

/// A registration beside its reconstruction, and a code from a kernel density.
#[test]
fn a_folder_has_the_registrations_and_densities_of_its_run() {
    let Some(browser) = Browser::find() else { return };
    let data = Packed::new();
    data.train().succeeded();
    data.run("model prior @/run --kind kde").succeeded();
    data.run("view @/run --export @/site --registrations 2").succeeded();
    let run = Run::open(data.at("run"), &Device::default()).unwrap();
    let mut live = Live::open(&browser, &file_url(&data.at("site")), WIDE);
    live.evaluate("cape.ready");
    live.evaluate("cape.settled()");
    let outfit: Outfit = live.evaluate("cape.state().outfit").as_str().unwrap().parse().unwrap();
    set(&mut live, "#prior", "kde");
    for seed in [1, 2, 3, 40] {
        set(&mut live, "#seed", &seed.to_string());
        let found = numbers(&live.evaluate("cape.state().z"));
        let prior = run.prior_of_kind("kde").unwrap().unwrap();
        let sampled = prior.sample(outfit, 1, 1.0, seed);
        assert!(relative_error(&found, &sampled.row(0).to_vec()) < 1e-6, "{found:?} {sampled}");
    }

    let test = run.open_set(run.data().unwrap(), Split::Test).unwrap();
    let frame = test.frames() / 2;
    let (displacement, wearer) = registration(&test, frame).unwrap();
    let code = run.encode_frames(&test, &[frame]).unwrap();
    let truth = run.pose_clothed(&displacement, std::slice::from_ref(&wearer)).unwrap();
    let worn = run.dress(&code, &[wearer]).unwrap();
    click(&mut live, "#layer-truth");
    set(&mut live, "#truth", "1");
    let layers = live.evaluate("cape.layers()");
    let layers = layers.as_array().unwrap();
    for (kind, expected) in [("truth", &truth[0]), ("clothed", &worn[0])] {
        let layer = layers.iter().find(|layer| layer["kind"] == kind).unwrap();
        let error = relative_error(&numbers(&layer["positions"]), expected.vertices.as_flattened());
        assert!(error < MOST, "{kind}: {error}");
    }
    let clothed = layers.iter().find(|layer| layer["kind"] == "clothed").unwrap();
    let mut errors = vec![0.0; VERTICES];
    for &vertex in run.clothing() {
        let [a, b] = [&worn[0], &truth[0]].map(|mesh| Vec3::from(mesh.vertices[vertex]));
        errors[vertex] = a.distance(b);
    }
    assert!(relative_error(&numbers(&clothed["error"]), &errors) < 1e-2);
    keep("site-registration", &live.screenshot());
    click(&mut live, "#encode");
    let found = numbers(&live.evaluate("cape.state().z"));
    assert!(relative_error(&found, &code.row(0).to_vec()) < 1e-6);
    assert_eq!(live.complaints(), [""; 0]);
}

#[test]
fn the_folder_of_a_run_fits_a_telephone_and_is_dark_where_that_is_preferred() {
    let Some(browser) = Browser::find() else { return };
    let place = tempfile::tempdir().unwrap();
    let site = place.path().join("site");
    let path = trained().at("run");
    let done =
        cape(["view", path.to_str().unwrap(), "--json", "--export"]).arg(&site).output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let report: Value = serde_json::from_slice(&done.stdout).unwrap();
    let on_disk: u64 =
        fs::read_dir(&site).unwrap().map(|entry| entry.unwrap().metadata().unwrap().len()).sum();
    assert_eq!(report["bytes"].as_u64(), Some(on_disk));
    let view = View { width: 390, height: 844, scheme: Scheme::Dark };
    let mut live = Live::open(&browser, &file_url(&site), view);
    live.evaluate("cape.ready");
    live.evaluate("cape.settled()");
    let shot = live.screenshot();
    keep("site-narrow", &shot);
    let overflow = live.evaluate("document.documentElement.scrollWidth - innerWidth");
    assert!(overflow.as_f64().unwrap() <= 0.0, "{overflow} px too wide");
    assert_eq!(live.evaluate("cape.layers()[0].positions.length"), 3 * VERTICES);
    let run = Run::open(&path, &Device::default()).unwrap();
    let [state, layers] = ["cape.state()", "cape.layers()"].map(|what| live.evaluate(what));
    check(&run, &state, &layers);
    assert_eq!(live.complaints(), [""; 0]);
}

#[test]
fn a_damaged_model_is_said_on_the_page() {
    let Some(browser) = Browser::find() else { return };
    let place = tempfile::tempdir().unwrap();
    for entry in fs::read_dir(site()).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, place.path().join(path.file_name().unwrap())).unwrap();
    }
    let model = place.path().join("model.js");
    let text =
        fs::read_to_string(&model).unwrap().replacen("\"decoder\":\"H4", "\"decoder\":\"AA", 1);
    fs::write(&model, text).unwrap();
    let mut live = Live::open(&browser, &file_url(place.path()), WIDE);
    live.evaluate("cape.ready.catch(() => {})");
    assert_eq!(live.evaluate("document.querySelector('#failure').checkVisibility()"), true);
    let said = live.evaluate("document.querySelector('#failure').textContent");
    assert!(said.as_str().unwrap().contains("model"), "{said}");
}

#[test]
fn firefox_dresses_bodies_as_the_program_does() {
    let Some(mut page) = FirefoxPage::open(&file_url(site())) else { return };
    let run = cape_weights::pretrained(&Device::default()).unwrap();
    page.evaluate("cape.ready");
    for control in ["", "sample", "outfit-shortlong"] {
        if !control.is_empty() {
            page.evaluate(&format!("document.querySelector('#{control}').click()"));
        }
        page.evaluate("cape.settled()");
        let [state, layers] = ["cape.state()", "cape.layers()"].map(|what| page.evaluate(what));
        let errors = check(&run, &state, &layers);
        println!("{control}: {errors:?}, {} ms", state["latency"]);
    }
    keep("site-firefox", &page.screenshot());
    assert_eq!(page.complaints(), [""; 0]);
}

#[test]
fn occupied_folders_and_meshes_are_refused() {
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join("a"), "b").unwrap();
    let refused = |arguments: &[&str], parts: &[&str]| {
        let done = cape(["view"]).args(arguments).arg("--export").arg(place.path()).output();
        let done = done.unwrap();
        let said = String::from_utf8_lossy(&done.stderr).into_owned();
        assert!(!done.status.success() && parts.iter().all(|part| said.contains(part)), "{said}");
    };
    refused(&[], &["is not empty", "choose another --export"]);
    refused(&["female"], &["--export", "not a mesh"]);
    refused(&["--port", "8080"], &["--port", "cannot be used with"]);
    let site = place.path().join("site");
    let done = cape(["view", "--registrations", "3", "--export"]).arg(&site).output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(!done.status.success() && said.contains("no registrations"), "{said}");
    assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
}
