//! Rules that the servers of pages share.

use axum::{
    http::{HeaderMap, HeaderName, HeaderValue, header},
    response::{IntoResponse, Response},
};

const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
                      img-src 'self' data: blob:; connect-src 'self'; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";
const HEADERS: [(HeaderName, &str); 4] = [
    (header::CONTENT_SECURITY_POLICY, POLICY),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::CACHE_CONTROL, "no-store"),
];

/// The response with headers that keep the page to itself.
pub(crate) fn guarded(mut response: Response) -> Response {
    for (name, value) in HEADERS {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

/// Origins of a server of this machine on `port`.
pub(crate) fn local_origins(port: u16) -> Vec<String> {
    ["127.0.0.1", "localhost", "[::1]"].map(|host| format!("http://{host}:{port}")).to_vec()
}

/// True if the request is for one of the server's `origins` and not from another page.
pub(crate) fn is_own_request(origins: &[String], headers: &HeaderMap) -> bool {
    let text = |name: HeaderName| headers.get(name).and_then(|value| value.to_str().ok());
    let host_of = |origin: &String| origin.split_once("://").map(|(_, host)| host.to_owned());
    let Some(host) = text(header::HOST) else { return false };
    let Some(own) = origins.iter().find(|origin| host_of(origin).as_deref() == Some(host)) else {
        return false;
    };
    headers.get(header::ORIGIN).is_none_or(|origin| origin.as_bytes() == own.as_bytes())
}

/// Compares secrets in a time that does not depend on their content.
pub(crate) fn is_same_secret(given: &str, secret: &str) -> bool {
    let (given, secret) = (given.as_bytes(), secret.as_bytes());
    given.len() == secret.len()
        && given.iter().zip(secret).fold(0, |different, (a, b)| different | (a ^ b)) == 0
}

pub(crate) fn with_content_type(kind: &'static str, body: impl IntoResponse) -> Response {
    ([(header::CONTENT_TYPE, kind)], body).into_response()
}

/// 128 random bits, hexadecimal.
pub(crate) fn token() -> String {
    let bytes: [u8; 16] = rand::random();
    cape_core::hex(bytes)
}
