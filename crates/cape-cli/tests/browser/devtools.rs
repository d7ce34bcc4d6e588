//! A live page in headless Chromium, driven by its DevTools protocol.

use std::{
    fs,
    io::{BufRead, BufReader},
    net::TcpStream,
    path::PathBuf,
    process::{Child, Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use base64::{Engine, engine::general_purpose::STANDARD};
use cape::render::Image;
use serde_json::{Value, json};
use tempfile::TempDir;
use tungstenite::{Message, WebSocket, stream::MaybeTlsStream};

use crate::browser::{Browser, Scheme, View};

const PATIENCE: Duration = Duration::from_mins(1);

/// A page, and all that was logged.
pub(crate) struct Live {
    child: Child,
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    next: u64,
    session: Option<String>,
    complaints: Vec<String>,
    requests: Vec<String>,
    place: TempDir,
}

impl Live {
    /// Opens `url` in a window of its own.
    pub(crate) fn open(browser: &Browser, url: &str, view: View) -> Self {
        let place = tempfile::tempdir().unwrap();
        let mut child = Command::new(&browser.0)
            .args(["--headless=new", "--no-sandbox", "--hide-scrollbars", "--no-first-run"])
            .args(["--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
            .args(["--disable-dev-shm-usage", "--remote-debugging-port=0", "about:blank"])
            .arg(format!("--user-data-dir={}", place.path().join("profile").display()))
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let address = lines
            .by_ref()
            .map_while(Result::ok)
            .find_map(|line| line.strip_prefix("DevTools listening on ").map(ToOwned::to_owned))
            .expect("the browser's address");
        // A browser whose log nobody reads would wait.
        std::thread::spawn(move || lines.for_each(drop));
        let (socket, _) = tungstenite::connect(address).unwrap();
        if let MaybeTlsStream::Plain(stream) = socket.get_ref() {
            stream.set_read_timeout(Some(PATIENCE)).unwrap();
        }
        let mut live = Self {
            child,
            socket,
            next: 0,
            session: None,
            complaints: Vec::new(),
            requests: Vec::new(),
            place,
        };
        let target = live.ask("Target.createTarget", &json!({"url": "about:blank"}));
        let attached = live.ask(
            "Target.attachToTarget",
            &json!({"targetId": target["targetId"], "flatten": true}),
        );
        live.session = Some(attached["sessionId"].as_str().unwrap().to_owned());
        for domain in ["Runtime.enable", "Log.enable", "Page.enable", "Network.enable"] {
            live.ask(domain, &json!({}));
        }
        let scheme = match view.scheme {
            Scheme::Dark => "dark",
            Scheme::Light => "light",
        };
        live.ask(
            "Emulation.setEmulatedMedia",
            &json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]}),
        );
        live.ask(
            "Emulation.setDeviceMetricsOverride",
            &json!({"width": view.width, "height": view.height, "deviceScaleFactor": 1,
                    "mobile": view.width < 600}),
        );
        let downloads = live.downloads().display().to_string();
        live.ask(
            "Page.setDownloadBehavior",
            &json!({"behavior": "allow", "downloadPath": downloads}),
        );
        live.ask("Page.navigate", &json!({"url": url}));
        live.evaluate(
            "new Promise((yes, no) => { const wait = () => document.readyState === 'complete' \
             && location.href !== 'about:blank' ? yes() : setTimeout(wait, 20); wait(); })",
        );
        live
    }

    /// Directory of downloads.
    pub(crate) fn downloads(&self) -> PathBuf {
        self.place.path().join("downloads")
    }

    /// The value of an expression in the page, awaited.
    pub(crate) fn evaluate(&mut self, expression: &str) -> Value {
        let parameters =
            json!({"expression": expression, "awaitPromise": true, "returnByValue": true});
        let mut answer = self.ask("Runtime.evaluate", &parameters);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {answer}");
        answer["result"]["value"].take()
    }

    /// Screenshot of the page.
    pub(crate) fn screenshot(&mut self) -> Image {
        let answer = self.ask("Page.captureScreenshot", &json!({"format": "png"}));
        let bytes = STANDARD.decode(answer["data"].as_str().unwrap()).unwrap();
        let path = self.place.path().join("shot.png");
        fs::write(&path, bytes).unwrap();
        Image::load(&path).unwrap()
    }

    /// Errors that were logged or thrown so far.
    pub(crate) fn complaints(&self) -> &[String] {
        &self.complaints
    }

    /// Addresses that were asked for so far.
    pub(crate) fn requests(&self) -> &[String] {
        &self.requests
    }

    /// The finished download whose name ends so.
    pub(crate) fn download(&self, end: &str) -> PathBuf {
        let start = Instant::now();
        loop {
            let entries = fs::read_dir(self.downloads()).into_iter().flatten().flatten();
            let mut paths = entries.map(|entry| entry.path());
            // The browser reserves the name by an empty file, and moves the finished one there.
            let finished = |path: &PathBuf| {
                path.extension().is_some_and(|e| e == end)
                    && fs::metadata(path).is_ok_and(|file| file.len() > 0)
            };
            if let Some(path) = paths.find(finished) {
                return path;
            }
            assert!(start.elapsed() < PATIENCE, "no download of .{end}");
            sleep(Duration::from_millis(50));
        }
    }

    fn ask(&mut self, method: &str, parameters: &Value) -> Value {
        self.next += 1;
        let mut message = json!({"id": self.next, "method": method, "params": parameters});
        if let Some(session) = &self.session {
            message["sessionId"] = json!(session);
        }
        self.socket.send(Message::text(message.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else { continue };
            let mut said: Value = serde_json::from_str(&text).unwrap();
            if said["id"] == self.next {
                assert!(said["error"].is_null(), "{method}: {said}");
                return said["result"].take();
            }
            let parameters = &said["params"];
            if said["method"] == "Network.requestWillBeSent" {
                let url = parameters["request"]["url"].as_str().unwrap_or_default();
                self.requests.push(url.chars().take(200).collect());
            }
            let complains = match said["method"].as_str() {
                Some("Runtime.exceptionThrown") => true,
                Some("Log.entryAdded") => parameters["entry"]["level"] == "error",
                Some("Runtime.consoleAPICalled") => parameters["type"] == "error",
                _ => false,
            };
            if complains {
                self.complaints.push(parameters.to_string());
            }
        }
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
