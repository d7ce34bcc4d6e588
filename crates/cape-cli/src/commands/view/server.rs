//! Server of one page to this machine, and to others if that is asked for. All addresses begin with a
//! secret token; requests of other origins are refused, and, unless other machines are let in, those
//! for other names than this machine's own.

use std::sync::{
    Arc,
    atomic::{AtomicU32, Ordering},
    mpsc,
};

use axum::{
    Router,
    body::Bytes,
    extract::{
        DefaultBodyLimit, Path, Request as HttpRequest, State,
        ws::{Message as MotionFrame, WebSocket, WebSocketUpgrade},
    },
    http::{HeaderMap, StatusCode, Uri},
    middleware::{self, Next},
    response::{IntoResponse, Redirect, Response},
    routing::{any, get, post},
};
use tokio::{
    net::TcpListener,
    sync::{mpsc as channel, oneshot},
};

use super::{
    assets,
    wire::{self, Answer, Download, Message, Question, Request},
};
use crate::{
    error::{Error, Result},
    page_server::{guarded, is_loopback, is_own_request, is_same_secret, with_content_type},
};

/// Largest size of a message from the page, bytes.
const MOST_BYTES: usize = 64 * 1024;

/// Request to the thread that owns the model.
pub(super) enum ModelRequest {
    /// A request of a page; `newest` is the id of that page's latest picture request.
    Ask { request: Request, newest: Arc<AtomicU32>, reply: channel::UnboundedSender<Message> },
    /// A download.
    Save { download: Download, reply: oneshot::Sender<Result<Vec<u8>>> },
}

/// Constant state of the server.
pub(super) struct ServerState {
    pub(super) token: String,
    pub(super) scene: String,
    /// `[faces, 3]`, u32, little-endian.
    pub(super) faces: Vec<u8>,
    /// True if machines other than this one may ask, by any name of it.
    pub(super) remote: bool,
    /// True if a proxy on this machine passes requests on, under any name, with encryption or without.
    pub(super) proxied: bool,
    /// True if pages of other origins may show this one in a frame.
    pub(super) framed: bool,
    pub(super) jobs: mpsc::Sender<ModelRequest>,
}

/// Answers jobs until the server is gone.
pub(super) fn work(
    jobs: mpsc::Receiver<ModelRequest>,
    answer: impl Fn(&Question) -> Result<Answer>,
    file: impl Fn(&Download) -> Result<Vec<u8>>,
) {
    for job in jobs {
        match job {
            ModelRequest::Ask { request: Request { id, question }, newest, reply } => {
                if question.is_superseded() && newest.load(Ordering::Acquire) != id {
                    continue;
                }
                // A page that has gone does not listen.
                let _ = reply.send(wire::encode(id, &answer(&question)));
            }
            ModelRequest::Save { download, reply } => {
                let _ = reply.send(file(&download));
            }
        }
    }
}

/// Serves the site until the process ends.
pub(super) fn serve(listener: std::net::TcpListener, site: ServerState) -> Result {
    let fault = |error: std::io::Error| Error::message(format!("server: {error}"));
    listener.set_nonblocking(true).map_err(fault)?;
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(fault)?;
    runtime.block_on(async {
        let listener = TcpListener::from_std(listener).map_err(fault)?;
        axum::serve(listener, router(Arc::new(site))).await.map_err(fault)
    })
}

fn router(site: Arc<ServerState>) -> Router {
    Router::new()
        .route("/{token}", get(to_page))
        .route("/{token}/", get(page))
        .route("/{token}/scene.json", get(scene))
        .route("/{token}/faces.bin", get(faces))
        .route("/{token}/socket", any(socket))
        .route("/{token}/download", post(download))
        .route("/{token}/{asset}", get(asset))
        .layer(DefaultBodyLimit::max(MOST_BYTES))
        .layer(middleware::from_fn_with_state(site.clone(), guard))
        .with_state(site)
}

/// Admits requests with the token and from the page itself.
async fn guard(State(site): State<Arc<ServerState>>, request: HttpRequest, next: Next) -> Response {
    let allowed = is_here(&site, request.headers()) && knows(&site, request.uri());
    let response =
        if allowed { next.run(request).await } else { StatusCode::NOT_FOUND.into_response() };
    guarded(response, site.framed)
}

fn knows(site: &ServerState, uri: &Uri) -> bool {
    is_same_secret(uri.path().split('/').nth(1).unwrap_or_default(), &site.token)
}

/// True if the request is for a name of this server and not from another page.
fn is_here(site: &ServerState, headers: &HeaderMap) -> bool {
    let any_name = site.remote || site.proxied;
    let schemes: &[&str] = if site.proxied { &["http", "https"] } else { &["http"] };
    schemes.iter().any(|scheme| {
        is_own_request(headers, |host| {
            (any_name || is_loopback(host)).then(|| format!("{scheme}://{host}"))
        })
    })
}

async fn to_page(Path(token): Path<String>) -> Redirect {
    Redirect::permanent(&format!("/{token}/"))
}

async fn page() -> Response {
    with_content_type("text/html; charset=utf-8", assets::PAGE)
}

async fn asset(Path((_, name)): Path<(String, String)>) -> Response {
    match assets::find(&name) {
        Some((kind, text)) => with_content_type(kind, text),
        None => StatusCode::NOT_FOUND.into_response(),
    }
}

async fn scene(State(site): State<Arc<ServerState>>) -> Response {
    with_content_type("application/json", site.scene.clone())
}

async fn faces(State(site): State<Arc<ServerState>>) -> Response {
    with_content_type("application/octet-stream", site.faces.clone())
}

async fn download(State(site): State<Arc<ServerState>>, body: Bytes) -> Response {
    let refuse = |status: StatusCode, why: String| (status, why).into_response();
    let download: Download = match serde_json::from_slice(&body) {
        Ok(download) => download,
        Err(error) => return refuse(StatusCode::BAD_REQUEST, error.to_string()),
    };
    let (reply, answer) = oneshot::channel();
    if site.jobs.send(ModelRequest::Save { download, reply }).is_err() {
        return StatusCode::SERVICE_UNAVAILABLE.into_response();
    }
    match answer.await {
        Ok(Ok(bytes)) => with_content_type("application/octet-stream", bytes),
        Ok(Err(error)) => refuse(StatusCode::UNPROCESSABLE_ENTITY, error.to_string()),
        Err(_) => StatusCode::SERVICE_UNAVAILABLE.into_response(),
    }
}

async fn socket(State(site): State<Arc<ServerState>>, upgrade: WebSocketUpgrade) -> Response {
    upgrade.max_message_size(MOST_BYTES).on_upgrade(move |socket| handle_socket(socket, site))
}

/// Connection of one page.
async fn handle_socket(mut socket: WebSocket, site: Arc<ServerState>) {
    let newest = Arc::new(AtomicU32::new(0));
    let (reply, mut answers) = channel::unbounded_channel();
    loop {
        tokio::select! {
            message = socket.recv() => {
                let text = match message {
                    Some(Ok(MotionFrame::Text(text))) => text,
                    Some(Ok(MotionFrame::Ping(_) | MotionFrame::Pong(_))) => continue,
                    Some(Ok(MotionFrame::Binary(_))) => {
                        let _ = reply.send(wire::failure(0, "expected text"));
                        continue;
                    }
                    Some(Ok(MotionFrame::Close(_)) | Err(_)) | None => return,
                };
                let request: Request = match serde_json::from_str(&text) {
                    Ok(request) => request,
                    Err(error) => {
                        let _ = reply.send(wire::failure(0, &error.to_string()));
                        continue;
                    }
                };
                if request.question.is_superseded() {
                    newest.store(request.id, Ordering::Release);
                }
                let job = ModelRequest::Ask { request, newest: newest.clone(), reply: reply.clone() };
                if site.jobs.send(job).is_err() {
                    return;
                }
            }
            Some(answer) = answers.recv() => {
                let frame = match answer {
                    Message::Text(text) => MotionFrame::Text(text.into()),
                    Message::Binary(bytes) => MotionFrame::Binary(bytes.into()),
                };
                if socket.send(frame).await.is_err() {
                    return;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use axum::http::{HeaderValue, header};

    use super::*;

    fn site() -> ServerState {
        let (jobs, _) = mpsc::channel();
        ServerState {
            token: "secret".into(),
            scene: String::new(),
            faces: Vec::new(),
            remote: false,
            proxied: false,
            framed: false,
            jobs,
        }
    }

    #[test]
    fn only_the_page_itself_gets_in() {
        let site = site();
        let headers = |host: &'static str, origin: Option<&'static str>| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, HeaderValue::from_static(host));
            if let Some(origin) = origin {
                headers.insert(header::ORIGIN, HeaderValue::from_static(origin));
            }
            headers
        };
        assert!(is_here(&site, &headers("127.0.0.1:80", None)));
        assert!(is_here(&site, &headers("localhost:80", Some("http://localhost:80"))));
        // Forwarded by `ssh -L 8000:localhost:PORT`.
        assert!(is_here(&site, &headers("localhost:8000", Some("http://localhost:8000"))));
        assert!(is_here(&site, &headers("[::1]:8000", None)));
        assert!(is_here(&site, &headers("localhost", Some("http://localhost"))));
        for (host, origin) in [
            ("evil.example:80", None),
            ("localhost.evil.example:80", None),
            ("localhost:80.evil.example", None),
            ("localhost:", None),
            ("localhost:8000", Some("http://localhost:8001")),
            ("127.0.0.1:80", Some("http://evil.example")),
            ("127.0.0.1:80", Some("http://localhost:80")),
            ("127.0.0.1:80", Some("null")),
        ] {
            assert!(!is_here(&site, &headers(host, origin)), "{host} {origin:?}");
        }
        assert!(!is_here(&site, &HeaderMap::new()));
        let remote = ServerState { remote: true, ..self::site() };
        assert!(is_here(&remote, &headers("workstation:80", Some("http://workstation:80"))));
        assert!(!is_here(&remote, &headers("workstation:80", Some("http://evil.example"))));
        assert!(!is_here(&remote, &headers("workstation", Some("https://workstation"))));
        let proxied = ServerState { proxied: true, ..self::site() };
        for origin in [None, Some("https://hub.example"), Some("http://hub.example")] {
            assert!(is_here(&proxied, &headers("hub.example", origin)), "{origin:?}");
        }
        for origin in ["https://evil.example", "https://hub.example:8000", "ftp://hub.example"] {
            assert!(!is_here(&proxied, &headers("hub.example", Some(origin))), "{origin}");
        }
        let knows_of = |path: &'static str| knows(&site, &Uri::from_static(path));
        assert!(knows_of("/secret/") && knows_of("/secret/scene.json"));
        for path in ["/", "/Secret/", "/secre/", "/secrets/", "/../secret/", "/x/secret/"] {
            assert!(!knows_of(path), "{path}");
        }
    }

    #[test]
    fn stale_pictures_are_not_computed() {
        let (jobs, list) = mpsc::channel();
        let (reply, mut answers) = channel::unbounded_channel();
        let newest = Arc::new(AtomicU32::new(3));
        let ask = |id: u32, question: Question| ModelRequest::Ask {
            request: Request { id, question },
            newest: newest.clone(),
            reply: reply.clone(),
        };
        for job in
            [ask(1, Question::Frame(0)), ask(2, Question::Encode(0)), ask(3, Question::Frame(1))]
        {
            jobs.send(job).unwrap();
        }
        drop(jobs);
        let asked = std::cell::RefCell::new(Vec::new());
        work(
            list,
            |question| {
                asked.borrow_mut().push(question.clone());
                Err(Error::message("not found"))
            },
            |_| Err(Error::message("not found")),
        );
        assert_eq!(asked.into_inner(), [Question::Encode(0), Question::Frame(1)]);
        for id in [2, 3] {
            let Ok(Message::Text(text)) = answers.try_recv() else { panic!("no answer") };
            assert_eq!(text, format!(r#"{{"id":{id},"error":"not found"}}"#));
        }
    }
}
