//! Server of a study. All addresses begin with a rater's secret token; pages of other origins get
//! nothing. The page is never told which picture of a scored pair is real.

use std::{
    collections::HashMap,
    fs::{self, File, OpenOptions},
    io::{Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
    time::{SystemTime, UNIX_EPOCH},
};

use axum::{
    Router,
    body::Bytes,
    extract::{DefaultBodyLimit, Path as UrlPath, Request, State},
    http::StatusCode,
    middleware::{self, Next},
    response::{IntoResponse, Redirect, Response},
    routing::{get, post},
};
use cape_study::{Answer, PairKind, StudyDesign, Trial, read_answers, web};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::net::TcpListener;

use crate::{
    error::{Error, Result},
    page_server::{guarded, is_loopback, is_own_request, is_same_secret, token, with_content_type},
};

/// Largest size of a message from the page, bytes.
const MOST_BYTES: usize = 64 * 1024;
/// Largest number of events other than answers that are recorded of a rater.
const MOST_EVENTS: usize = 100;

/// A rater and the secret of their link.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Rater {
    #[serde(rename = "rater")]
    pub(super) name: String,
    pub(super) token: String,
}

impl Rater {
    /// The raters of the study in `directory`, `raters.json`, completed to `count`.
    pub(super) fn of_study(directory: &Path, count: usize) -> Result<Vec<Self>> {
        let path = directory.join("raters.json");
        let mut raters: Vec<Self> = if path.exists() {
            let text = fs::read(&path).map_err(|error| Error::io(&path, error))?;
            serde_json::from_slice(&text)
                .map_err(|error| Error::message(format!("{}: {error}", path.display())))?
        } else {
            Vec::new()
        };
        if raters.len() < count {
            for number in raters.len()..count {
                raters.push(Self { name: format!("rater-{:03}", number + 1), token: token() });
            }
            cape_infer::write_json(&path, &raters)?;
        }
        Ok(raters)
    }
}

/// State of the server.
pub(super) struct StudyServer {
    design: StudyDesign,
    stimuli: PathBuf,
    raters: Vec<Rater>,
    schedules: Vec<Vec<Trial>>,
    /// Origin by which raters reach the server, beside those of this machine.
    origin: String,
    /// Paragraphs of consent, and the page to go to at the end.
    texts: (Vec<String>, Option<String>),
    log: Mutex<AnswerLog>,
}

/// The file of answers, and the positions of the raters.
struct AnswerLog {
    file: File,
    /// Number of trials that each rater has answered.
    answered: Vec<usize>,
    events: Vec<usize>,
}

/// Answer as the page sends it.
#[derive(Debug, Deserialize)]
struct PageAnswer {
    index: usize,
    side: Side,
    rt_ms: f64,
    window: Value,
    events: Value,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Side {
    Left,
    Right,
}

impl StudyServer {
    pub(super) fn new(
        design: StudyDesign,
        directory: &Path,
        raters: Vec<Rater>,
        origin: String,
        texts: (Vec<String>, Option<String>),
    ) -> Result<Self> {
        let path = directory.join("answers.jsonl");
        let file = open_log(&path)?;
        let mut counts: HashMap<String, usize> = HashMap::new();
        for answer in read_answers(&design, &path)? {
            *counts.entry(answer.rater).or_default() += 1;
        }
        let answered =
            raters.iter().map(|rater| counts.get(&rater.name).copied().unwrap_or(0)).collect();
        let events = vec![0; raters.len()];
        let schedules = (0..raters.len()).map(|rater| design.schedule(rater)).collect();
        Ok(Self {
            design,
            stimuli: directory.join("stimuli"),
            raters,
            schedules,
            origin,
            texts,
            log: Mutex::new(AnswerLog { file, answered, events }),
        })
    }

    /// Origin of the page at `host`; none for the hosts of others.
    fn origin_of(&self, host: &str) -> Option<String> {
        if is_loopback(host) {
            return Some(format!("http://{host}"));
        }
        self.origin
            .split_once("://")
            .filter(|(_, known)| *known == host)
            .map(|_| self.origin.clone())
    }

    fn rater(&self, given: &str) -> Option<usize> {
        self.raters.iter().position(|rater| is_same_secret(given, &rater.token))
    }

    fn is_practice(&self, trial: &Trial) -> bool {
        self.design.pairs[trial.pair].kind == PairKind::Practice
    }

    fn plan(&self, rater: usize) -> Value {
        let schedule = &self.schedules[rater];
        let practised = schedule.iter().filter(|trial| self.is_practice(trial)).count();
        let trial = |(place, trial): (usize, &Trial)| {
            let practice = place < practised;
            let (number, count) = if practice {
                (place + 1, practised)
            } else {
                (place + 1 - practised, schedule.len() - practised)
            };
            json!({
                "left": trial.left,
                "right": trial.right,
                "number": number,
                "count": count,
                "practice": practice,
            })
        };
        let log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        json!({
            "consent": self.texts.0,
            "completion": self.texts.1,
            "next": log.answered[rater],
            "trials": schedule.iter().enumerate().map(trial).collect::<Vec<_>>(),
        })
    }

    /// Records an answer; returns the reply, or the status of a refusal.
    fn record(&self, rater: usize, given: PageAnswer) -> Result<Value, StatusCode> {
        let mut log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        let trial = self.schedules[rater].get(given.index).ok_or(StatusCode::BAD_REQUEST)?;
        if log.answered[rater] != given.index {
            return Err(StatusCode::CONFLICT);
        }
        if !given.rt_ms.is_finite() || given.rt_ms < 0.0 {
            return Err(StatusCode::BAD_REQUEST);
        }
        let chosen = match given.side {
            Side::Left => trial.left.clone(),
            Side::Right => trial.right.clone(),
        };
        let answer = Answer {
            rater: self.raters[rater].name.clone(),
            trial: trial.clone(),
            chosen,
            rt_ms: given.rt_ms,
        };
        let failed = |_| StatusCode::INTERNAL_SERVER_ERROR;
        let mut line = serde_json::to_value(&answer).map_err(failed)?;
        line["window"] = given.window;
        line["events"] = given.events;
        line["at"] = json!(now());
        log.append(&line)?;
        log.answered[rater] += 1;
        // Practice alone is followed by the answer.
        Ok(if self.is_practice(trial) {
            json!({"correct": !answer.is_fooled(&self.design)})
        } else {
            json!({})
        })
    }

    fn record_event(&self, rater: usize, event: Value) -> Result<Value, StatusCode> {
        let mut log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        if log.events[rater] >= MOST_EVENTS {
            return Err(StatusCode::TOO_MANY_REQUESTS);
        }
        log.events[rater] += 1;
        // Nested, so that no event can be taken for an answer.
        log.append(&json!({"event": event, "rater": self.raters[rater].name, "at": now()}))?;
        Ok(json!({}))
    }
}

impl AnswerLog {
    fn append(&mut self, line: &Value) -> Result<(), StatusCode> {
        let text = format!("{line}\n");
        let written = self.file.stream_position().and_then(|start| {
            let done = self.file.write_all(text.as_bytes()).and_then(|()| self.file.sync_data());
            // A line that was written in part would spoil the next.
            done.inspect_err(|_| drop(self.file.set_len(start)))
        });
        written.map_err(|_| StatusCode::INSUFFICIENT_STORAGE)
    }
}

/// Opens the file of answers for this process alone, without a last line that was cut off.
fn open_log(path: &Path) -> Result<File> {
    let fault = |error| Error::io(path, error);
    let mut file = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(path)
        .map_err(fault)?;
    file.try_lock().map_err(|_| {
        Error::message(format!("{}: another `cape study serve` writes it", path.display()))
    })?;
    let text = fs::read(path).map_err(fault)?;
    let whole = text.iter().rposition(|&byte| byte == b'\n').map_or(0, |last| last + 1);
    file.set_len(whole as u64).map_err(fault)?;
    file.seek(SeekFrom::End(0)).map_err(fault)?;
    Ok(file)
}

/// Seconds since 1970.
fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs())
}

/// Serves the study until the process ends.
pub(super) fn serve(listener: std::net::TcpListener, server: StudyServer) -> Result {
    let fault = |error: std::io::Error| Error::message(format!("server: {error}"));
    listener.set_nonblocking(true).map_err(fault)?;
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(fault)?;
    runtime.block_on(async {
        let listener = TcpListener::from_std(listener).map_err(fault)?;
        axum::serve(listener, router(Arc::new(server))).await.map_err(fault)
    })
}

fn router(server: Arc<StudyServer>) -> Router {
    Router::new()
        .route("/{token}", get(to_page))
        .route("/{token}/", get(page))
        .route("/{token}/plan.json", get(plan))
        .route("/{token}/answer", post(answer))
        .route("/{token}/event", post(event))
        .route("/{token}/stimuli/{name}", get(stimulus))
        .route("/{token}/{asset}", get(asset))
        .layer(DefaultBodyLimit::max(MOST_BYTES))
        .layer(middleware::from_fn_with_state(server.clone(), guard))
        .with_state(server)
}

/// Admits requests with a rater's token and from the page itself.
async fn guard(State(server): State<Arc<StudyServer>>, request: Request, next: Next) -> Response {
    let given = request.uri().path().split('/').nth(1).unwrap_or_default();
    let allowed = is_own_request(request.headers(), |host| server.origin_of(host))
        && server.rater(given).is_some();
    let response =
        if allowed { next.run(request).await } else { StatusCode::NOT_FOUND.into_response() };
    guarded(response, false)
}

async fn to_page(UrlPath(token): UrlPath<String>) -> Redirect {
    Redirect::permanent(&format!("/{token}/"))
}

async fn page() -> Response {
    file_of_page("index.html")
}

async fn asset(UrlPath((_, name)): UrlPath<(String, String)>) -> Response {
    file_of_page(&name)
}

fn file_of_page(name: &str) -> Response {
    let kind = match name.rsplit_once('.').map(|(_, extension)| extension) {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        _ => "text/javascript; charset=utf-8",
    };
    match web::SERVED.iter().find(|(known, _)| *known == name) {
        Some((_, text)) => with_content_type(kind, *text),
        None => StatusCode::NOT_FOUND.into_response(),
    }
}

async fn plan(State(server): State<Arc<StudyServer>>, UrlPath(token): UrlPath<String>) -> Response {
    reply(&server, &token, |rater| Ok(server.plan(rater)))
}

async fn answer(
    State(server): State<Arc<StudyServer>>,
    UrlPath(token): UrlPath<String>,
    body: Bytes,
) -> Response {
    reply(&server, &token, |rater| {
        let given = serde_json::from_slice(&body).map_err(|_| StatusCode::BAD_REQUEST)?;
        server.record(rater, given)
    })
}

async fn event(
    State(server): State<Arc<StudyServer>>,
    UrlPath(token): UrlPath<String>,
    body: Bytes,
) -> Response {
    reply(&server, &token, |rater| {
        let given = serde_json::from_slice(&body).map_err(|_| StatusCode::BAD_REQUEST)?;
        server.record_event(rater, given)
    })
}

fn reply(
    server: &StudyServer,
    token: &str,
    work: impl FnOnce(usize) -> Result<Value, StatusCode>,
) -> Response {
    match server.rater(token).ok_or(StatusCode::NOT_FOUND).and_then(work) {
        Ok(value) => with_content_type("application/json", value.to_string()),
        Err(status) => status.into_response(),
    }
}

async fn stimulus(
    State(server): State<Arc<StudyServer>>,
    UrlPath((_, name)): UrlPath<(String, String)>,
) -> Response {
    // Names in the design are hashes: no path leads out of the directory.
    if !server.design.stimuli().contains(name.as_str()) {
        return StatusCode::NOT_FOUND.into_response();
    }
    match fs::read(server.stimuli.join(&name)) {
        Ok(bytes) => with_content_type("image/png", bytes),
        Err(_) => StatusCode::NOT_FOUND.into_response(),
    }
}
