//! STL files, binary and text. Their triangles have no common vertices: corners at the same place
//! become one vertex, in the order in which they first appear.

use super::{
    file::{Geometry, weld},
    text,
};

/// Length of the header of a binary file, with the number of triangles, and of one triangle, bytes.
const HEADER: usize = 84;
const TRIANGLE: usize = 50;

/// True if the length is that of a binary file of as many triangles as the header says. Binary files
/// may begin with `solid` like those in text.
pub(super) fn is_binary(bytes: &[u8]) -> bool {
    declared(bytes).is_some_and(|count| count > 0 && bytes.len() == HEADER + TRIANGLE * count)
}

/// True if the file is STL in text.
pub(super) fn is_text(bytes: &[u8]) -> bool {
    let text = text::without_mark(bytes).trim_ascii_start();
    text.starts_with(b"solid") && text.windows(5).take(1 << 16).any(|word| word == b"facet")
}

fn declared(bytes: &[u8]) -> Option<usize> {
    let count = bytes.get(80..HEADER)?.try_into().ok()?;
    Some(u32::from_le_bytes(count) as usize)
}

pub(super) fn parse(bytes: &[u8]) -> Result<Geometry, String> {
    let corners =
        if !is_binary(bytes) && is_text(bytes) { from_text(bytes)? } else { binary(bytes)? };
    Ok(weld(&corners))
}

fn binary(bytes: &[u8]) -> Result<Vec<[f32; 3]>, String> {
    let count =
        declared(bytes).ok_or("neither a binary STL file nor `solid` and `facet` in text")?;
    let size = TRIANGLE.saturating_mul(count);
    let triangles = bytes[HEADER..].get(..size).ok_or_else(|| {
        format!(
            "the header declares {count} triangles, {size} bytes, but {} follow",
            bytes.len() - HEADER
        )
    })?;
    let (triangles, _) = triangles.as_chunks::<TRIANGLE>();
    Ok(triangles
        .iter()
        .flat_map(|triangle| {
            // The normal comes first, two bytes of attributes last.
            let (numbers, _) = triangle[12..48].as_chunks::<4>();
            let (corners, _) = numbers.as_chunks::<3>();
            [0, 1, 2].map(|corner| corners[corner].map(f32::from_le_bytes))
        })
        .collect())
}

fn from_text(bytes: &[u8]) -> Result<Vec<[f32; 3]>, String> {
    let text = String::from_utf8_lossy(bytes);
    let mut corners = Vec::new();
    let mut words = text.split_ascii_whitespace();
    // The name after `solid` may have any words but `facet`.
    while words.by_ref().any(|word| word == "facet") {
        let start = corners.len();
        while let Some(word) = words.next() {
            match word {
                "vertex" => {
                    let mut corner = [0.0; 3];
                    for axis in &mut corner {
                        *axis = text::number(words.next().ok_or("the file ends inside a vertex")?)?;
                    }
                    corners.push(corner);
                }
                "endfacet" => break,
                _ => {}
            }
        }
        let found = corners.len() - start;
        if found != 3 {
            return Err(format!("facet {} has {found} vertices, expected 3", start / 3));
        }
    }
    Ok(corners)
}
