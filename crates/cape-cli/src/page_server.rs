//! Rules that the servers of pages share.

use axum::{
    http::{HeaderMap, HeaderName, HeaderValue, header},
    response::{IntoResponse, Response},
};

/// Policy of pages that other pages may show in a frame.
const FRAMED_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
                             img-src 'self' data: blob:; connect-src 'self'; base-uri 'none'; \
                             form-action 'none'";
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
                      img-src 'self' data: blob:; connect-src 'self'; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";
const HEADERS: [(HeaderName, &str); 3] = [
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::CACHE_CONTROL, "no-store"),
];

/// The response with headers that keep the page to itself, but for pages that show it in a frame, if they
/// are allowed to.
pub(crate) fn guarded(mut response: Response, framed: bool) -> Response {
    let policy = if framed { FRAMED_POLICY } else { POLICY };
    for (name, value) in HEADERS.into_iter().chain([(header::CONTENT_SECURITY_POLICY, policy)]) {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

/// True for a name of this machine for itself, with any port: `ssh -L` forwards from another one.
pub(crate) fn is_loopback(host: &str) -> bool {
    let (name, port) = match host.rsplit_once(':') {
        Some((name, port)) if !port.ends_with(']') => (name, Some(port)),
        _ => (host, None),
    };
    let digits = |port: &str| !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit());
    ["127.0.0.1", "localhost", "[::1]"].contains(&name) && port.is_none_or(digits)
}

/// True if the request is for a host of this server, for which `origin_of` has an origin, and not from
/// another page.
pub(crate) fn is_own_request(
    headers: &HeaderMap,
    origin_of: impl Fn(&str) -> Option<String>,
) -> bool {
    let host = headers.get(header::HOST).and_then(|host| host.to_str().ok());
    let Some(own) = host.and_then(origin_of) else { return false };
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
