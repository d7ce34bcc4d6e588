//! A page in Firefox, driven by WebDriver BiDi, on a display of Xvfb: headless Firefox has no WebGL.

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    net::TcpStream,
    path::PathBuf,
    process::{Child, Command, Stdio},
    time::Duration,
};

use base64::{Engine, engine::general_purpose::STANDARD};
use cape::render::Image;
use serde_json::{Value, json};
use tempfile::TempDir;
use tungstenite::{Message, WebSocket, stream::MaybeTlsStream};

const FIREFOX: [&str; 2] = ["firefox", "firefox-esr"];
const DISPLAY: [&str; 1] = ["Xvfb"];
const PATIENCE: Duration = Duration::from_mins(2);

/// A page, and all errors that were logged.
pub(crate) struct FirefoxPage {
    child: Child,
    display: Child,
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    next: u64,
    context: Value,
    complaints: Vec<String>,
    profile: TempDir,
}

/// Firefox and Xvfb; says so if one is missing.
fn programs() -> Option<[PathBuf; 2]> {
    let firefox = std::env::var_os("CAPE_FIREFOX").map(PathBuf::from);
    if let (Some(firefox), Some(display)) = (firefox.or_else(|| find(&FIREFOX)), find(&DISPLAY)) {
        return Some([firefox, display]);
    }
    // Not by `eprintln!`, which the test harness keeps to itself.
    let text =
        "\n!!! NOT TESTED: pages in Firefox. Install it, or name it in CAPE_FIREFOX, and Xvfb.\n\n";
    std::io::stderr().write_all(text.as_bytes()).unwrap();
    None
}

fn find(names: &[&str]) -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let places: Vec<PathBuf> = std::env::split_paths(&path).collect();
    let mut candidates = places.iter().flat_map(|place| names.iter().map(|name| place.join(name)));
    candidates.find(|candidate| candidate.is_file())
}

impl FirefoxPage {
    /// Opens `url`; none without Firefox or a display.
    pub(crate) fn open(url: &str) -> Option<Self> {
        let [firefox, display] = programs()?;
        let profile = tempfile::tempdir().unwrap();
        let mut display = Command::new(display)
            .args(["-displayfd", "1", "-screen", "0", "1280x900x24", "-nolisten", "tcp"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut number = String::new();
        BufReader::new(display.stdout.as_mut().unwrap()).read_line(&mut number).unwrap();
        let mut child = Command::new(firefox)
            .args(["--no-remote", "--remote-debugging-port", "0", "--profile"])
            .arg(profile.path())
            .env("DISPLAY", format!(":{}", number.trim()))
            .env_remove("WAYLAND_DISPLAY")
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let address = lines
            .by_ref()
            .map_while(Result::ok)
            .find_map(|line| {
                line.strip_prefix("WebDriver BiDi listening on ").map(ToOwned::to_owned)
            })
            .expect("the browser's address");
        // A browser whose log nobody reads would wait.
        std::thread::spawn(move || lines.for_each(drop));
        let (socket, _) = tungstenite::connect(format!("{address}/session")).unwrap();
        if let MaybeTlsStream::Plain(stream) = socket.get_ref() {
            stream.set_read_timeout(Some(PATIENCE)).unwrap();
        }
        let mut page = Self {
            child,
            display,
            socket,
            next: 0,
            context: Value::Null,
            complaints: Vec::new(),
            profile,
        };
        page.ask("session.new", &json!({"capabilities": {}}));
        page.ask("session.subscribe", &json!({"events": ["log.entryAdded"]}));
        let tree = page.ask("browsingContext.getTree", &json!({}));
        page.context = tree["contexts"][0]["context"].clone();
        let context = page.context.clone();
        page.ask(
            "browsingContext.navigate",
            &json!({"context": context, "url": url, "wait": "complete"}),
        );
        Some(page)
    }

    /// The value of an expression in the page, awaited.
    pub(crate) fn evaluate(&mut self, expression: &str) -> Value {
        let answer = self.ask(
            "script.evaluate",
            &json!({
                "expression": format!("(async () => JSON.stringify(await ({expression})) ?? null)()"),
                "target": {"context": self.context},
                "awaitPromise": true,
            }),
        );
        assert_eq!(answer["type"], "success", "{expression}: {answer}");
        answer["result"]["value"]
            .as_str()
            .map_or(Value::Null, |text| serde_json::from_str(text).unwrap())
    }

    /// Screenshot of the page.
    pub(crate) fn screenshot(&mut self) -> Image {
        let context = self.context.clone();
        let answer = self.ask("browsingContext.captureScreenshot", &json!({"context": context}));
        let bytes = STANDARD.decode(answer["data"].as_str().unwrap()).unwrap();
        let path = self.profile.path().join("shot.png");
        fs::write(&path, bytes).unwrap();
        Image::load(&path).unwrap()
    }

    /// Errors that were logged or thrown so far.
    pub(crate) fn complaints(&self) -> &[String] {
        &self.complaints
    }

    fn ask(&mut self, method: &str, parameters: &Value) -> Value {
        self.next += 1;
        let message = json!({"id": self.next, "method": method, "params": parameters});
        self.socket.send(Message::text(message.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else { continue };
            let mut said: Value = serde_json::from_str(&text).unwrap();
            if said["id"] == self.next {
                assert_eq!(said["type"], "success", "{method}: {said}");
                return said["result"].take();
            }
            if said["method"] == "log.entryAdded" && said["params"]["level"] == "error" {
                self.complaints.push(said["params"]["text"].to_string());
            }
        }
    }
}

impl Drop for FirefoxPage {
    fn drop(&mut self) {
        // It may have ended already.
        for child in [&mut self.child, &mut self.display] {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}
