//! OFF files in text, also with colours, normals and texture coordinates, which are skipped but for
//! normals.

use super::{file::Geometry, polygon::fan, text};

/// The header word, after comments, without the counts that some exporters append to it (`OFF216 183 0`): prefix and
/// length, if the file begins with one.
pub(super) fn header(bytes: &[u8]) -> Option<(&str, usize)> {
    let bytes = text::without_mark(bytes);
    let mut rest = bytes.trim_ascii_start();
    while rest.starts_with(b"#") {
        let end = rest.iter().position(|&byte| byte == text::line_end(bytes))?;
        rest = rest[end..].trim_ascii_start();
    }
    let skipped = bytes.len() - rest.len();
    let word = rest.split(|byte| !byte.is_ascii_alphanumeric()).next()?;
    let word = std::str::from_utf8(word).ok()?;
    let at = word.find("OFF")?;
    let prefixes = ["", "C", "N", "CN", "ST", "STC", "STN", "STCN", "4", "n", "4n"];
    let rest = &word[at + 3..];
    let known = prefixes.contains(&&word[..at]) && rest.bytes().all(|byte| byte.is_ascii_digit());
    known.then_some((&word[..at], skipped + at + 3))
}

pub(super) fn parse(bytes: &[u8]) -> Result<Geometry, String> {
    let (prefix, length) = header(bytes).ok_or("not an OFF file (expected `OFF` at the start)")?;
    if prefix.contains(['4', 'n']) {
        return Err(format!(
            "`{prefix}OFF` has points of other than 3 coordinates, expected `OFF`"
        ));
    }
    let body = &text::without_mark(bytes)[length..];
    if body.trim_ascii_start().starts_with(b"BINARY") {
        return Err("binary OFF is not supported: save it as text, or as .ply".into());
    }
    let end = text::line_end(body);
    let mut rows = body
        .split(|&byte| byte == end)
        .map(|line| String::from_utf8_lossy(line))
        .enumerate()
        .filter(|(_, line)| text::words(line).next().is_some());
    let (_, counts) = rows.next().ok_or("no line with the numbers of vertices and faces")?;
    let mut counts = text::words(&counts).map(str::parse::<usize>);
    let (Some(Ok(vertices)), Some(Ok(faces))) = (counts.next(), counts.next()) else {
        return Err("expected the numbers of vertices and faces after `OFF`".into());
    };
    // Each takes at least one line of two bytes.
    if vertices.saturating_add(faces) > body.len() / 2 + 1 {
        return Err(format!(
            "the header declares {vertices} vertices and {faces} faces, but only {} bytes follow",
            body.len()
        ));
    }
    let mut found = Geometry::default();
    let mut normals = Vec::new();
    for index in 0..vertices {
        let (line, row) =
            rows.next().ok_or_else(|| format!("{index} vertices, expected {vertices}"))?;
        let at = |message: String| format!("line {}: {message}", line + 1);
        let numbers: Vec<f32> =
            text::words(&row).take(6).map(text::number).collect::<Result<_, _>>().map_err(at)?;
        let [x, y, z, rest @ ..] = numbers.as_slice() else {
            return Err(at(format!("vertex {index} has {} numbers, expected 3", numbers.len())));
        };
        found.mesh.vertices.push([*x, *y, *z]);
        if let ([nx, ny, nz], true) = (rest, prefix.contains('N')) {
            normals.push([*nx, *ny, *nz]);
        }
    }
    for index in 0..faces {
        let (line, row) = rows.next().ok_or_else(|| format!("{index} faces, expected {faces}"))?;
        let at = |message: String| format!("line {}: {message}", line + 1);
        let mut words = text::words(&row);
        let count: usize = words.next().and_then(|word| word.parse().ok()).unwrap_or_default();
        let corners: Vec<u32> = words.take(count).filter_map(|word| word.parse().ok()).collect();
        if corners.len() != count {
            return Err(at(format!(
                "face {index} has {} vertices, expected {count}",
                corners.len()
            )));
        }
        if let Some(corner) = corners.iter().find(|&&corner| corner as usize >= vertices) {
            return Err(at(format!("vertex {corner} is out of range: there are {vertices}")));
        }
        let before = found.mesh.faces.len();
        found.mesh.faces.extend(fan(&corners));
        found.skipped += usize::from(found.mesh.faces.len() == before);
    }
    found.normals = (normals.len() == vertices && vertices > 0).then_some(normals);
    Ok(found)
}
