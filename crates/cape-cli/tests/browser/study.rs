//! The pages of a perceptual study.

use std::{
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::Child,
    sync::OnceLock,
    thread::sleep,
    time::Duration,
};

use serde_json::Value;

use crate::{
    browser::{Browser, Scheme, View},
    devtools::Live,
    keep,
    serve::serve,
    support::{Packed, run, trained},
};

const WIDE: View = View { width: 1280, height: 860, scheme: Scheme::Light };
const TELEPHONE: View = View { width: 390, height: 780, scheme: Scheme::Dark };

/// A small study: 6 scored pairs, one catch pair, one practice pair.
fn study() -> &'static Path {
    static STUDY: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    &STUDY
        .get_or_init(|| {
            let place = tempfile::tempdir().unwrap();
            let out = place.path().join("study");
            make(trained(), &out);
            (place, out)
        })
        .1
}

fn make(packed: &Packed, out: &Path) {
    let line = "study make @/run --poses 2 --a-pose 1 --matched 0 --catches 1 --practice 1 --out";
    let line = line.replace('@', packed.root().to_str().unwrap());
    let words = line.split(' ').chain([out.to_str().unwrap()]);
    run(words).succeeded();
}

/// A copy of the study, for one test to answer.
fn copy(name: &str) -> (tempfile::TempDir, PathBuf) {
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join(name);
    fs::create_dir_all(out.join("stimuli")).unwrap();
    for entry in fs::read_dir(study().join("stimuli")).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, out.join("stimuli").join(path.file_name().unwrap())).unwrap();
    }
    for name in ["design.json", "consent.txt"] {
        fs::copy(study().join(name), out.join(name)).unwrap();
    }
    (place, out)
}

/// `cape study serve`, until it is dropped.
struct Server {
    child: Child,
    urls: Vec<String>,
}

impl Server {
    fn start(study: &Path) -> Self {
        let words = ["study", "serve", study.to_str().unwrap(), "--raters", "2"];
        let (child, links) = serve(words);
        let links = links.as_array().unwrap().iter();
        Self { child, urls: links.map(|link| link["url"].as_str().unwrap().to_owned()).collect() }
    }

    /// Status and body of a request to a path below the first rater's token.
    fn request(&self, method: &str, path: &str, headers: &str, body: &str) -> (u16, String) {
        let (host, token) = self.urls[0].strip_prefix("http://").unwrap().split_once('/').unwrap();
        let mut stream = TcpStream::connect(host).unwrap();
        let target = if path.starts_with('/') { path.into() } else { format!("/{token}{path}") };
        let host =
            if headers.contains("Host:") { String::new() } else { format!("Host: {host}\r\n") };
        let length = body.len();
        write!(
            stream,
            "{method} {target} HTTP/1.1\r\n{host}{headers}Content-Length: {length}\r\nConnection: close\r\n\r\n{body}"
        )
        .unwrap();
        let mut text = String::new();
        let _ = stream.read_to_string(&mut text);
        let status = text.split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap_or(0);
        (status, text.split_once("\r\n\r\n").map_or(String::new(), |(_, body)| body.to_owned()))
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Waits until an element is there.
fn wait(live: &mut Live, selector: &str) {
    live.evaluate(&format!(
        "new Promise((yes, no) => {{ const end = Date.now() + 20000; const look = () => \
         document.querySelector('{selector}') ? yes() : Date.now() > end ? \
         no(new Error('no {selector} in ' + document.body.innerText)) : setTimeout(look, 20); look(); }})"
    ));
}

fn press(live: &mut Live, key: &str) {
    live.evaluate(&format!(
        "document.dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}', bubbles: true}}))"
    ));
}

/// Number of the pair that is shown.
fn count(live: &mut Live) -> String {
    live.evaluate("document.querySelector('.count')?.textContent ?? ''")
        .as_str()
        .unwrap()
        .to_owned()
}

fn answers(study: &Path) -> Vec<Value> {
    let text = fs::read_to_string(study.join("answers.jsonl")).unwrap();
    let lines = text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    lines.filter(|line| line.get("chosen").is_some()).collect()
}

/// Presses the button of a page. A page stays until the server has answered, so a pressed one is marked.
fn next(live: &mut Live) {
    wait(live, ".next:not([data-pressed])");
    live.evaluate(
        "(() => { const next = document.querySelector('.next'); next.dataset.pressed = ''; next.click(); })()",
    );
}

/// Waits for the numbered page and answers it by an arrow key.
fn answer(live: &mut Live, number: &str, key: &str) {
    wait(live, ".choice:enabled");
    for _ in 0..500 {
        if count(live) == number {
            break;
        }
        sleep(Duration::from_millis(20));
    }
    assert_eq!(count(live), number);
    wait(live, ".choice:enabled");
    press(live, key);
}

#[test]
fn a_rater_answers_by_keyboard_and_goes_on_after_a_reload() {
    let Some(browser) = Browser::find() else { return };
    let (_place, study) = copy("answered");
    let server = Server::start(&study);
    let mut live = Live::open(&browser, &server.urls[0], WIDE);
    wait(&mut live, ".next");
    keep("study-consent", &live.screenshot());
    next(&mut live);
    next(&mut live);
    wait(&mut live, ".choice:enabled");
    keep("study-practice", &live.screenshot());
    answer(&mut live, "Practice 1 of 1", "ArrowLeft");
    next(&mut live);
    next(&mut live);
    answer(&mut live, "Pair 1 of 7", "ArrowLeft");
    answer(&mut live, "Pair 2 of 7", "ArrowRight");
    wait(&mut live, ".choice:enabled");
    keep("study-pair", &live.screenshot());
    let alts = live.evaluate("[...document.images].map(image => image.alt).join('|')");
    let alts = alts.as_str().unwrap();
    assert!(alts.contains("Left picture") && alts.contains("Right picture"), "{alts}");

    for _ in 0..500 {
        if answers(&study).len() == 3 {
            break;
        }
        sleep(Duration::from_millis(20));
    }
    live.evaluate("location.reload()");
    sleep(Duration::from_millis(500));
    for number in 3..=7 {
        answer(&mut live, &format!("Pair {number} of 7"), "ArrowRight");
    }
    live.evaluate(
        "new Promise(yes => { const look = () => document.body.innerText.includes('Thank you') ? yes() \
         : setTimeout(look, 20); look(); })",
    );
    assert!(live.complaints().is_empty(), "{:?}", live.complaints());

    let written = answers(&study);
    assert_eq!(written.len(), 8);
    let sides: String =
        written.iter().map(|line| if line["chosen"] == line["left"] { 'l' } else { 'r' }).collect();
    assert_eq!(sides, "llrrrrrr");
    assert!(written.iter().all(|line| line["rater"] == "rater-001"
        && line["rt_ms"].as_f64().unwrap() >= 0.0
        && line["window"][0] == 1280
        && line["events"][0]["type"] == "key"));
    let study = study.to_str().unwrap();
    let score = run(["study", "score", study, "--fastest", "0", "--catch-share", "0", "--json"])
        .succeeded();
    let score: Value = serde_json::from_str(&score).unwrap();
    assert_eq!((&score["raters"], &score["cases"][0]["answers"]), (&1.into(), &2.into()));
}

#[test]
fn the_server_tells_nothing_and_refuses_others() {
    let (_place, study) = copy("guarded");
    let server = Server::start(&study);
    let (status, plan) = server.request("GET", "plan.json", "", "");
    assert_eq!(status, 200);
    let plan: Value = serde_json::from_str(&plan).unwrap();
    assert_eq!((plan["trials"].as_array().unwrap().len(), &plan["next"]), (8, &0.into()));
    let keys: Vec<&String> = plan["trials"][3].as_object().unwrap().keys().collect();
    assert_eq!(keys, ["count", "left", "number", "practice", "right"]);
    for (path, headers) in [
        ("/", ""),
        ("/0123456789abcdef0123456789abcdef/plan.json", ""),
        ("plan.json", "Host: evil.example\r\n"),
        ("plan.json", "Origin: http://evil.example\r\n"),
        ("design.json", ""),
        ("stimuli/../design.json", ""),
        ("stimuli/..%2Fdesign.json", ""),
    ] {
        assert_eq!(server.request("GET", path, headers, "").0, 404, "{path} {headers}");
    }
    let body = |index: usize| {
        format!(r#"{{"index":{index},"side":"left","rt_ms":900,"window":[1,2,1],"events":[]}}"#)
    };
    assert_eq!(server.request("POST", "answer", "", "{}").0, 400);
    assert_eq!(server.request("POST", "answer", "", &body(1)).0, 409);
    let (status, practice) = server.request("POST", "answer", "", &body(0));
    assert!(status == 200 && practice.contains("correct"), "{status} {practice}");
    assert_eq!(server.request("POST", "answer", "", &body(0)).0, 409);
    assert_eq!(server.request("POST", "answer", "", &body(1)), (200, "{}".into()));
    assert_eq!(server.request("POST", "answer", "", &"x".repeat(70_000)).0, 413);
    // An event cannot be taken for an answer.
    assert_eq!(server.request("POST", "event", "", r#"{"chosen":"x","pair":0}"#).0, 200);
    assert_eq!(answers(&study).len(), 2);
    let second = run(["study", "serve", study.to_str().unwrap()]);
    second.failed_saying(&["answers.jsonl", "another `cape study serve`"]);

    // A line that was cut off is dropped, and the links stay.
    let urls: Vec<String> =
        server.urls.iter().map(|url| url.rsplit('/').nth(1).unwrap().into()).collect();
    drop(server);
    let mut log = fs::OpenOptions::new().append(true).open(study.join("answers.jsonl")).unwrap();
    log.write_all(b"{\"rater\":\"rat").unwrap();
    let server = Server::start(&study);
    assert!(server.urls.iter().zip(urls).all(|(url, token)| url.contains(&token)));
    let (_, plan) = server.request("GET", "plan.json", "", "");
    assert!(plan.contains("\"next\":2"), "{plan}");
    assert_eq!(answers(&study).len(), 2);
}

#[test]
fn on_a_telephone_in_the_dark_the_pair_fits() {
    let Some(browser) = Browser::find() else { return };
    let (_place, study) = copy("telephone");
    let server = Server::start(&study);
    let mut live = Live::open(&browser, &server.urls[1], TELEPHONE);
    next(&mut live);
    next(&mut live);
    wait(&mut live, ".choice:enabled");
    keep("study-telephone", &live.screenshot());
    let fits = live.evaluate(
        "document.documentElement.scrollWidth <= innerWidth && [...document.querySelectorAll('.choice')]\
         .every(choice => choice.getBoundingClientRect().bottom <= innerHeight)",
    );
    assert_eq!(fits, true);
}

/// Serves the files of a directory until the process ends.
fn serve_files(root: PathBuf) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            let mut line = String::new();
            let mut request = BufReader::new(stream.try_clone().unwrap());
            request.read_line(&mut line).unwrap();
            let mut header = line.clone();
            while header.trim() != "" {
                header.clear();
                if request.read_line(&mut header).unwrap_or(0) == 0 {
                    break;
                }
            }
            let path = line.split(' ').nth(1).unwrap_or("/").split('?').next().unwrap();
            let kind = match path.rsplit('.').next() {
                Some("js") => "text/javascript",
                Some("css") => "text/css",
                Some("html") => "text/html",
                _ => "image/png",
            };
            let file = fs::read(root.join(path.trim_start_matches('/')));
            let (status, body) = file.map_or((404, Vec::new()), |body| (200, body));
            let length = body.len();
            let _ = write!(
                stream,
                "HTTP/1.1 {status} -\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n"
            );
            let _ = stream.write_all(&body);
        }
    });
    format!("http://{address}")
}

#[test]
fn the_exported_folder_runs_under_simulation() {
    let Some(browser) = Browser::find() else { return };
    let place = tempfile::tempdir().unwrap();
    let site = place.path().join("site");
    let (from, to) = (study().to_str().unwrap(), site.to_str().unwrap());
    run(["study", "export", from, "--out", to, "--raters", "3"]).succeeded();
    let design = fs::read_to_string(study().join("design.json")).unwrap();
    assert!(design.contains("\"generated\""));
    let data = fs::read_to_string(site.join("study-data.js")).unwrap();
    assert!(!data.contains("generated") && !data.contains("\"real\""));

    let address = serve_files(site.clone());
    let file = format!("file://{}/index.html", site.display());
    let web = format!("{address}/index.html");
    for (page, mode) in [(&file, "data-only"), (&web, "visual")] {
        let url = format!("{page}?PROLIFIC_PID=p%2F1&STUDY_ID=s&simulate={mode}");
        let mut live = Live::open(&browser, &url, WIDE);
        let results = live.evaluate(
            "new Promise(yes => { const look = () => window.capeResults ? yes(window.capeResults) \
             : setTimeout(look, 50); look(); })",
        );
        assert!(live.complaints().is_empty(), "{mode}: {:?}", live.complaints());
        let path = place.path().join("results.json");
        fs::write(&path, results.as_str().unwrap()).unwrap();
        let events: Vec<Value> = serde_json::from_str(results.as_str().unwrap()).unwrap();
        let chosen: Vec<&Value> = events.iter().filter(|e| e.get("chosen").is_some()).collect();
        assert_eq!(chosen.len(), 8, "{mode}");
        assert!(
            chosen.iter().all(|event| event["rater"] == "p/1" && event["prolific_study"] == "s")
        );
        let words =
            ["study", "score", from, "--catch-share", "0", "--fastest", "0", "--json", "--answers"];
        let score = run(words.into_iter().chain([path.to_str().unwrap()])).succeeded();
        let score: Value = serde_json::from_str(&score).unwrap();
        assert_eq!(score["raters"], 1, "{mode}");
    }
    let mut live = Live::open(&browser, &web, WIDE);
    next(&mut live);
    wait(&mut live, ".next");
    next(&mut live);
    wait(&mut live, ".choice:enabled");
    keep("study-export", &live.screenshot());
}
