//! The page of `cape view`.

use std::{
    collections::HashSet,
    fs,
    io::{Read, Write},
    net::TcpStream,
    process::Child,
};

use cape::{
    core::{Mesh, obj},
    render::Image,
};
use serde_json::Value;
use tungstenite::{ClientRequestBuilder, Message, http::Uri};

use crate::{
    browser::{Browser, Scheme, View},
    devtools::Live,
    keep,
    serve::serve,
    support::{VERTICES, run_line, trained},
};

pub(crate) const WIDE: View = View { width: 1280, height: 800, scheme: Scheme::Light };

/// `cape view`, until it is dropped.
struct Server {
    child: Child,
    url: String,
}

impl Server {
    fn start(of: &str) -> Self {
        Self::start_with(of, &[])
    }

    fn start_with(of: &str, options: &[&str]) -> Self {
        let path = trained().at(of);
        let words = ["view", path.to_str().unwrap(), "--no-open"];
        let (child, report) = serve(words.iter().chain(options));
        Self { child, url: report["url"].as_str().unwrap().to_owned() }
    }

    /// Host and port, and the secret.
    fn parts(&self) -> (&str, &str) {
        let (host, token) = self.url.strip_prefix("http://").unwrap().split_once('/').unwrap();
        (host, token.trim_end_matches('/'))
    }

    /// Status and body of a request that is sent as it stands.
    fn request(&self, method: &str, target: &str, headers: &str, body: &str) -> (u16, String) {
        let mut stream = TcpStream::connect(self.parts().0).unwrap();
        let length = body.len();
        write!(
            stream,
            "{method} {target} HTTP/1.1\r\n{headers}Content-Length: {length}\r\nConnection: close\r\n\r\n{body}"
        )
        .unwrap();
        let mut answer = Vec::new();
        // A server that refuses a body may close before it has read all of it.
        let _ = stream.read_to_end(&mut answer);
        let text = String::from_utf8_lossy(&answer).into_owned();
        let status = text.split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap_or(0);
        (status, text.split_once("\r\n\r\n").map_or(String::new(), |(_, body)| body.to_owned()))
    }

    fn get(&self, target: &str) -> u16 {
        let host = format!("Host: {}\r\n", self.parts().0);
        self.request("GET", target, &host, "").0
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Moves a control of the page.
pub(crate) fn set(live: &mut Live, control: &str, value: &str) {
    live.evaluate(&format!(
        "(() => {{ const control = document.querySelector('{control}'); control.value = '{value}'; \
         for (const kind of ['input', 'change']) \
         control.dispatchEvent(new Event(kind, {{bubbles: true}})); }})()"
    ));
    live.evaluate("cape.settled()");
}

pub(crate) fn click(live: &mut Live, control: &str) {
    live.evaluate(&format!("document.querySelector('{control}').click()"));
    live.evaluate("cape.settled()");
}

/// Share of pixels that differ.
pub(crate) fn difference(a: &Image, b: &Image) -> f64 {
    let pairs = a.pixels().iter().zip(b.pixels());
    pairs.filter(|(a, b)| a != b).count() as f64 / a.pixels().len() as f64
}

#[test]
fn sliders_outfits_and_samples_change_the_picture() {
    let Some(browser) = Browser::find() else { return };
    let server = Server::start("run");
    let mut live = Live::open(&browser, &server.url, WIDE);
    live.evaluate("cape.ready");
    live.evaluate("cape.settled()");
    let first = live.screenshot();
    keep("viewer", &first);
    let strongest = live.evaluate("document.querySelector('input[type=range][id^=\"z-\"]').id");
    let mut last = first;
    for (control, value) in
        [(format!("#{}", strongest.as_str().unwrap()), "3"), ("#beta-0".to_owned(), "3")]
    {
        set(&mut live, &control, value);
        let now = live.screenshot();
        assert!(difference(&last, &now) > 0.001, "{control} changes nothing");
        last = now;
    }
    click(&mut live, "#outfit-shortshort");
    assert_eq!(live.evaluate("cape.state().outfit"), "shortshort");
    let before = live.evaluate("cape.state().z");
    click(&mut live, "#sample");
    assert_ne!(live.evaluate("cape.state().z"), before);
    assert!(live.evaluate("cape.state().answers").as_u64().unwrap() >= 5);
    assert_eq!(live.complaints(), [""; 0]);
}

#[test]
fn a_clothing_layer_has_sliders_of_body_motion_size_and_material() {
    let Some(browser) = Browser::find() else { return };
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    let options = "--garment skirt --exercises march --frames 8 --resolution 50 --lengths 0.8,1.1";
    run_line(&format!("layer synth {options} --out {}", at("set"))).succeeded();
    run_line(&format!("layer learn {} --components 4 --out {}", at("set"), at("learned")))
        .succeeded();
    let layer = at("learned/layer.npz");
    let server = Server::start(&layer);
    let mut live = Live::open(&browser, &server.url, WIDE);
    live.evaluate("cape.ready");
    live.evaluate("cape.settled()");
    let mut last = live.screenshot();
    keep("viewer-layer", &last);
    assert_eq!(live.evaluate("document.querySelectorAll('[id^=\"parameter-\"]').length"), 1);
    let (length, shape) = ("#parameter-0", "#layer-beta-1");
    for (control, value) in
        [("#scrub", "20"), (length, "0.75"), (shape, "3"), ("#movement", "squats")]
    {
        set(&mut live, control, value);
        let now = live.screenshot();
        assert!(difference(&last, &now) > 0.001, "{control} changes nothing");
        last = now;
    }
    keep("viewer-layer-changed", &last);
    assert_eq!(live.evaluate("cape.state().motion"), "squats");
    assert_eq!(live.evaluate("cape.state().frame"), 0, "a motion begins at its first frame");
    click(&mut live, "#parameters-mean");
    let mean = live.evaluate("cape.state().parameters[0]").as_f64().unwrap();
    assert!(mean > 0.75, "the mean of both lengths: {mean}");
    let faces = live.evaluate("cape.state().triangles").as_u64().unwrap();
    assert!(faces > 13_776, "body and clothing: {faces}");
    live.evaluate("document.querySelector('#play').click()");
    // Five seconds at most.
    live.evaluate(
        "new Promise(resolve => { let left = 100; const wait = () => \
         cape.state().frame > 0 || left-- === 0 ? resolve() : setTimeout(wait, 50); wait(); })",
    );
    click(&mut live, "#play");
    assert!(live.evaluate("cape.state().frame").as_u64().unwrap() > 0, "it plays");
    assert_eq!(live.complaints(), [""; 0]);
}

#[test]
fn downloads_parse() {
    let Some(browser) = Browser::find() else { return };
    let server = Server::start("run");
    let mut live = Live::open(&browser, &server.url, WIDE);
    live.evaluate("cape.ready");
    live.evaluate("cape.settled()");
    set(&mut live, "#colours", "displacement");
    for format in ["obj", "ply", "glb", "png"] {
        click(&mut live, &format!("#download-{format}"));
    }
    let found = ["obj", "ply", "glb", "png"].map(|end| live.download(end));
    assert_eq!(obj::read(&found[0]).unwrap().mesh.vertices.len(), VERTICES);
    assert_eq!(Mesh::load(&found[1]).unwrap().vertices.len(), VERTICES);
    assert_eq!(&fs::read(&found[2]).unwrap()[..4], b"glTF");
    let picture = Image::load(&found[3]).unwrap();
    keep("viewer-download", &picture);
    let canvas = live.evaluate("document.querySelector('canvas').height").as_u64().unwrap() as u32;
    let (width, below) = (picture.width(), picture.height() - canvas);
    let bar: HashSet<_> = (0..width).filter_map(|x| picture.get(x, canvas + below / 2)).collect();
    assert!(bar.len() > 100, "a colour bar of {} colours below the picture", bar.len());
    assert_eq!(live.complaints(), [""; 0]);
}

#[test]
fn the_page_fits_a_telephone_and_is_dark_where_that_is_preferred() {
    let Some(browser) = Browser::find() else { return };
    let server = Server::start("run");
    let view = View { width: 390, height: 844, scheme: Scheme::Dark };
    let mut live = Live::open(&browser, &server.url, view);
    live.evaluate("cape.ready");
    live.evaluate("cape.settled()");
    let shot = live.screenshot();
    keep("viewer-narrow", &shot);
    let overflow = live.evaluate("document.documentElement.scrollWidth - innerWidth");
    assert!(overflow.as_f64().unwrap() <= 0.0, "{overflow} px too wide");
    let [r, g, b, _] = shot.get(view.width / 2, view.height - 3).unwrap();
    assert!(u32::from(r) + u32::from(g) + u32::from(b) < 250, "the panel is bright");
    let unnamed = live.evaluate(
        "[...document.querySelectorAll('button, input, select')].filter(control => \
         !(control.labels?.length || control.getAttribute('aria-label') \
         || control.getAttribute('aria-labelledby') || control.textContent.trim())) \
         .map(control => control.id || control.outerHTML)",
    );
    assert_eq!(unnamed, serde_json::json!([]), "controls without a name");
    assert_eq!(live.complaints(), [""; 0]);
}

#[test]
fn nobody_else_gets_in() {
    let server = Server::start("run");
    let (host, token) = server.parts();
    assert_eq!(server.get(&format!("/{token}/")), 200);
    assert_eq!(server.get(&format!("/{token}/viewer.js")), 200);
    for target in ["/", "/scene.json", "/0123456789abcdef0123456789abcdef/", "/index.html"] {
        assert_eq!(server.get(target), 404, "{target}");
    }
    for path in
        ["../../etc/passwd", "..%2f..%2fetc%2fpasswd", "%2e%2e/Cargo.toml", "mod.rs", "config.toml"]
    {
        assert_eq!(server.get(&format!("/{token}/{path}")), 404, "{path}");
    }
    let page = format!("/{token}/");
    let ours = format!("Host: {host}\r\n");
    for headers in [
        "Host: evil.example\r\n".to_owned(),
        String::new(),
        format!("{ours}Origin: http://evil.example\r\n"),
        format!("{ours}Origin: null\r\n"),
    ] {
        let (status, body) = server.request("GET", &page, &headers, "");
        assert!(status >= 400 && !body.contains("<html"), "{headers:?}: {status}");
    }
    let socket = |origin: &str| {
        let uri: Uri = format!("ws://{host}/{token}/socket").parse().unwrap();
        tungstenite::connect(ClientRequestBuilder::new(uri).with_header("Origin", origin))
    };
    assert!(socket("http://evil.example").is_err());
    assert!(socket(&format!("http://{host}")).is_ok());
    let big = "x".repeat(200_000);
    let target = format!("/{token}/download");
    assert_ne!(server.request("POST", &target, &ours, &big).0, 200);
    assert_eq!(server.request("POST", &target, &ours, "{").0, 400);
    let unknown = r#"{"format":"obj","frame":9}"#;
    assert_eq!(server.request("POST", &target, &ours, unknown).0, 422);
    assert_eq!(server.get(&page), 200);
}

#[test]
fn only_a_framed_viewer_is_shown_by_other_pages() {
    for (options, framed) in [(&[][..], false), (&["--framed"][..], true)] {
        let server = Server::start_with("run", options);
        let (host, token) = server.parts();
        let mut stream = TcpStream::connect(host).unwrap();
        write!(stream, "GET /{token}/ HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n")
            .unwrap();
        let mut response = String::new();
        stream.read_to_string(&mut response).unwrap();
        assert!(response.contains("default-src 'none'"), "{response}");
        assert_eq!(!response.contains("frame-ancestors 'none'"), framed);
    }
}

#[test]
fn malformed_messages_do_not_end_the_server() {
    let server = Server::start("run");
    let (host, token) = server.parts();
    let connect = || tungstenite::connect(format!("ws://{host}/{token}/socket")).unwrap().0;
    let mut socket = connect();
    for text in ["", "{", "[]", r#"{"id":1}"#, r#"{"id":1,"show":{"z":[]}}"#, "\u{0}"] {
        socket.send(Message::text(text)).unwrap();
        let answer: Value =
            serde_json::from_str(socket.read().unwrap().to_text().unwrap()).unwrap();
        assert!(answer["error"].is_string(), "{text:?}: {answer}");
    }
    let show = |z: &str, pose: usize| {
        let pose = vec!["0"; pose].join(",");
        format!(
            r#"{{"id":7,"show":{{"z":{z},"betas":[],"pose":[{pose}],"outfit":"longlong","layers":["clothed"]}}}}"#
        )
    };
    for wrong in [show("[1,2,3]", 72), show("[]", 71), show("[1e39]", 72)] {
        socket.send(Message::text(wrong)).unwrap();
        let answer: Value =
            serde_json::from_str(socket.read().unwrap().to_text().unwrap()).unwrap();
        assert!(answer["error"].is_string(), "{answer}");
    }
    let mut other = connect();
    // Refused, and the connection with it.
    let _ = other.send(Message::text("x".repeat(100_000)));
    while other.read().is_ok() {}
    let sample =
        r#"{"id":8,"sample":{"prior":"normal","temperature":1,"seed":1,"outfit":"longlong"}}"#;
    socket.send(Message::text(sample)).unwrap();
    let answer: Value = serde_json::from_str(socket.read().unwrap().to_text().unwrap()).unwrap();
    let code = answer["z"].to_string();
    assert_eq!(answer["id"], 8);
    socket.send(Message::text(show(&code, 72))).unwrap();
    let Message::Binary(bytes) = socket.read().unwrap() else { panic!("expected a picture") };
    assert_eq!(bytes.len(), 16 + 4 + VERTICES * 24);
    assert_eq!(&bytes[..4], b"CAPE");
}

#[test]
fn a_mesh_is_shown_without_a_model() {
    let Some(browser) = Browser::find() else { return };
    let server = Server::start("run/body.npz");
    let mut live = Live::open(&browser, &server.url, WIDE);
    live.evaluate("cape.ready");
    live.evaluate("cape.settled()");
    keep("viewer-mesh", &live.screenshot());
    assert_eq!(
        live.evaluate("document.querySelector('#sample')?.checkVisibility() ?? false"),
        false
    );
    assert_eq!(live.complaints(), [""; 0]);
}
