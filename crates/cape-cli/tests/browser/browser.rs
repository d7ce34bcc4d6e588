//! Headless Chromium, as far as the tests need it.

use std::{
    fs::{self, File},
    io::Write,
    path::{Path, PathBuf},
    process::Command,
    thread::sleep,
    time::{Duration, Instant},
};

use cape::render::Image;
use serde::Deserialize;

const NAMES: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
const PATIENCE: Duration = Duration::from_mins(1);
/// Message of the harness on the console, which shows that the console is listened to.
const GREETING: &str = "cape: the page was measured";

/// Measures the page once it and all images are loaded. The page is in a frame, whose width can be
/// less than the 500 pixels that Chromium's windows have at least.
const PROBE: &str = r#"
addEventListener("load", () => {
  const frame = document.querySelector("iframe"), page = frame.contentDocument;
  const rect = element => {
    const { x, y, width, height } = element.getBoundingClientRect();
    return { x, y, width, height };
  };
  const texts = elements => [...elements].map(element => element.textContent);
  const found = {
    title: page.title,
    overflow: page.documentElement.scrollWidth - frame.contentWindow.innerWidth,
    tables: [...page.querySelectorAll("table")].map(table => ({
      header: texts(table.querySelectorAll("th")),
      rows: [...table.rows].filter(row => row.querySelector("td")).map(row => ({
        class: row.className, cells: texts(row.cells), rect: rect(row),
      })),
    })),
    images: [...page.images].map(image => ({
      alt: image.alt, width: image.naturalWidth, height: image.naturalHeight, rect: rect(image),
    })),
  };
  const out = document.createElement("pre");
  out.id = "probe";
  out.hidden = true;
  out.textContent = JSON.stringify(found);
  document.body.append(out);
  console.log("GREETING");
});
"#;

/// Preferred colour scheme.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Scheme {
    Dark,
    Light,
}

/// The window.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) scheme: Scheme,
}

/// A page that was shown.
pub(crate) struct Shot {
    pub(crate) image: Image,
    pub(crate) page: Page,
}

/// Measurements in the page.
#[derive(Debug, Deserialize)]
pub(crate) struct Page {
    pub(crate) title: String,
    /// Pixels by which the page is wider than the window.
    pub(crate) overflow: f64,
    pub(crate) tables: Vec<Table>,
    pub(crate) images: Vec<Picture>,
    #[serde(skip)]
    pub(crate) console_errors: Vec<String>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Table {
    pub(crate) header: Vec<String>,
    pub(crate) rows: Vec<Row>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Row {
    pub(crate) class: String,
    pub(crate) cells: Vec<String>,
    pub(crate) rect: Rect,
}

/// An image with its own size and its place on the page.
#[derive(Debug, Deserialize)]
pub(crate) struct Picture {
    pub(crate) alt: String,
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) rect: Rect,
}

#[derive(Debug, Clone, Copy, Deserialize)]
pub(crate) struct Rect {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) width: f64,
    pub(crate) height: f64,
}

pub(crate) struct Browser(pub(crate) PathBuf);

impl Browser {
    /// The browser to test with; says so if there is none.
    pub(crate) fn find() -> Option<Self> {
        if let Some(named) = std::env::var_os("CAPE_BROWSER") {
            return Some(Self(named.into()));
        }
        let path = std::env::var_os("PATH").unwrap_or_default();
        let candidates =
            std::env::split_paths(&path).flat_map(|place| NAMES.map(|name| place.join(name)));
        let found = candidates.into_iter().find(|candidate| candidate.is_file()).map(Self);
        if found.is_none() {
            // Not by `eprintln!`, which the test harness keeps to itself.
            let text = format!(
                "\n!!! NOT TESTED: pages in a browser. None of {} is in the path; install \
                 Chromium or name it in CAPE_BROWSER.\n\n",
                NAMES.join(", ")
            );
            std::io::stderr().write_all(text.as_bytes()).unwrap();
        }
        found
    }

    /// Shows `html`.
    pub(crate) fn show(&self, html: &str, view: View) -> Shot {
        let directory = tempfile::tempdir().unwrap();
        let harness = directory.path().join("harness.html");
        fs::write(&harness, harness_of(html, view)).unwrap();
        let picture = directory.path().join("shot.png");
        let (dom, log) = self.run(directory.path(), view, &picture, &harness);

        let said: Vec<&str> = log.lines().filter(|line| line.contains("CONSOLE")).collect();
        assert!(said.iter().any(|line| line.contains(GREETING)), "nothing was measured:\n{log}");
        let probe = between(&dom, "<pre id=\"probe\" hidden=\"\">", "</pre>")
            .unwrap_or_else(|| panic!("no measurements in the page:\n{log}"));
        let probe = probe.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&");
        let mut page: Page = serde_json::from_str(&probe).unwrap();
        page.console_errors = said
            .into_iter()
            .filter(|line| !line.contains(GREETING))
            .map(ToOwned::to_owned)
            .collect();
        Shot { image: Image::load(&picture).unwrap(), page }
    }

    /// Runs the browser to its end; returns the page's elements and the log.
    fn run(&self, place: &Path, view: View, picture: &Path, page: &Path) -> (String, String) {
        let (out, log) = (place.join("out"), place.join("log"));
        let scheme = match view.scheme {
            Scheme::Dark => 0,
            Scheme::Light => 1,
        };
        let mut command = Command::new(&self.0);
        command
            .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"])
            .args(["--no-first-run", "--disable-dev-shm-usage", "--force-device-scale-factor=1"])
            .args(["--enable-logging=stderr", "--v=0", "--dump-dom"])
            .arg(format!("--window-size={},{}", view.width, view.height))
            .arg(format!("--blink-settings=preferredColorScheme={scheme}"))
            .arg(format!("--user-data-dir={}", place.join("profile").display()))
            .arg(format!("--screenshot={}", picture.display()))
            .arg(format!("file://{}", page.display()))
            // To files: a browser whose output nobody reads would wait.
            .stdout(File::create(&out).unwrap())
            .stderr(File::create(&log).unwrap());
        let mut child =
            command.spawn().unwrap_or_else(|error| panic!("{}: {error}", self.0.display()));
        let start = Instant::now();
        let read = |path| String::from_utf8_lossy(&fs::read(path).unwrap()).into_owned();
        let status = loop {
            if let Some(status) = child.try_wait().unwrap() {
                break status;
            }
            if start.elapsed() > PATIENCE {
                child.kill().unwrap();
                panic!("{} hangs:\n{}", self.0.display(), read(&log));
            }
            sleep(Duration::from_millis(20));
        };
        assert!(status.success(), "{}: {status}\n{}", self.0.display(), read(&log));
        (read(&out), read(&log))
    }
}

fn harness_of(html: &str, View { width, height, .. }: View) -> String {
    let page = html.replace('&', "&amp;").replace('"', "&quot;");
    let probe = PROBE.replace("GREETING", GREETING);
    format!(
        "<!doctype html><meta charset=\"utf-8\"><body style=\"margin:0\"><iframe \
         style=\"display:block;border:0;width:{width}px;height:{height}px\" srcdoc=\"{page}\">\
         </iframe><script>{probe}</script></body>"
    )
}

fn between<'a>(text: &'a str, start: &str, end: &str) -> Option<&'a str> {
    let (_, rest) = text.split_once(start)?;
    rest.split_once(end).map(|(inside, _)| inside)
}
