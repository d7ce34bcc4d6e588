//! Triangles of polygons and strips.

/// True if the three corners differ.
pub(crate) fn is_face([a, b, c]: [u32; 3]) -> bool {
    a != b && b != c && c != a
}

/// Triangles of a polygon, as a fan; none of fewer than three different corners.
pub(crate) fn fan(corners: &[u32]) -> impl Iterator<Item = [u32; 3]> {
    let first = corners.first().copied().unwrap_or_default();
    let pairs = corners.get(1..).unwrap_or_default().windows(2);
    pairs.map(move |pair| [first, pair[0], pair[1]]).filter(|&face| is_face(face))
}

/// Triangles of a strip, all of the orientation of the first.
pub(crate) fn strip(corners: &[u32]) -> impl Iterator<Item = [u32; 3]> {
    let turned = |(index, three): (usize, &[u32])| {
        let odd = index % 2;
        [three[odd], three[1 - odd], three[2]]
    };
    corners.windows(3).enumerate().map(turned).filter(|&face| is_face(face))
}
