use rayon::prelude::*;

/// Face index of samples without a triangle.
pub(crate) const EMPTY: u32 = u32::MAX;
/// Fixed-point positions per sample, so that coverage is exact integer arithmetic.
const SUBSAMPLES: i64 = 256;
/// Rows of samples per parallel task.
pub(crate) const BAND: usize = 16;
/// Largest coordinate that is drawn, samples; edge functions of larger ones would overflow.
const MAX_COORDINATE: f32 = 1e6;

/// Vertex in image space.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Point {
    /// Horizontal position, 1/256 samples.
    pub(crate) x: i64,
    /// Vertical position, 1/256 samples, downwards.
    pub(crate) y: i64,
    /// Depth, affine in image space, increasing with distance.
    pub(crate) z: f32,
    /// Reciprocal of the clip-space w, for perspective-correct interpolation.
    pub(crate) inverse_w: f32,
    /// False for points behind the camera, far outside the image or not finite.
    pub(crate) valid: bool,
}

impl Point {
    /// Point at clip coordinates `[x, y, z, w]` in an image of `width`×`height` samples.
    pub(crate) fn project([x, y, z, w]: [f32; 4], width: usize, height: usize) -> Self {
        let inverse_w = w.recip();
        let sx = (x * inverse_w * 0.5 + 0.5) * width as f32;
        let sy = (0.5 - y * inverse_w * 0.5) * height as f32;
        let z = z * inverse_w;
        let valid = w > 0.0
            && z >= 0.0
            && z.is_finite()
            && sx.abs() < MAX_COORDINATE
            && sy.abs() < MAX_COORDINATE;
        let round = |s: f32| if valid { (s * SUBSAMPLES as f32).round() as i64 } else { 0 };
        Self { x: round(sx), y: round(sy), z, inverse_w, valid }
    }
}

/// Visible triangle and depth of each sample.
#[derive(Debug)]
pub(crate) struct Visibility {
    /// Face index, `[height · width]`; [`EMPTY`] without a triangle.
    pub(crate) face: Vec<u32>,
    /// Depth, `[height · width]`; infinite without a triangle.
    pub(crate) depth: Vec<f32>,
}

/// Triangle set up for scan conversion, oriented so that the edge functions are positive inside.
struct Triangle {
    corners: [Point; 3],
    area: i64,
}

impl Triangle {
    fn new(points: &[Point], face: [u32; 3]) -> Option<Self> {
        let mut corners = [0, 1, 2].map(|i| points[face[i] as usize]);
        if !corners.iter().all(|corner| corner.valid) {
            return None;
        }
        let mut area = edge(&corners[0], &corners[1], corners[2].x, corners[2].y);
        if area < 0 {
            corners.swap(1, 2);
            area = -area;
        }
        (area > 0).then_some(Self { corners, area })
    }

    /// Calls `hit` with each covered column of `row` and its depth.
    fn scan(&self, row: usize, width: usize, mut hit: impl FnMut(usize, f32)) {
        let Some((first, last)) = span(self.corners.each_ref(), |p| p.x, width) else { return };
        let [a, b, c] = &self.corners;
        let (x, y) = (centre(first), centre(row));
        let edges = [(b, c), (c, a), (a, b)];
        let mut value = edges.map(|(p, q)| edge(p, q, x, y));
        let step = edges.map(|(p, q)| (p.y - q.y) * SUBSAMPLES);
        // Top-left rule: a sample on a shared edge belongs to exactly one triangle.
        let bias = edges.map(|(p, q)| i64::from(!(q.y < p.y || (q.y == p.y && q.x > p.x))));
        let scale = (self.area as f32).recip();
        for column in first..=last {
            if (0..3).all(|i| value[i] >= bias[i]) {
                let z =
                    (a.z * value[0] as f32 + b.z * value[1] as f32 + c.z * value[2] as f32) * scale;
                hit(column, z);
            }
            for i in 0..3 {
                value[i] += step[i];
            }
        }
    }
}

/// First and last sample whose centre a triangle may cover along one axis.
fn span(corners: [&Point; 3], axis: fn(&Point) -> i64, limit: usize) -> Option<(usize, usize)> {
    let [a, b, c] = corners.map(axis);
    let low = (a.min(b).min(c) - SUBSAMPLES / 2 + SUBSAMPLES - 1).div_euclid(SUBSAMPLES).max(0);
    let high = (a.max(b).max(c) - SUBSAMPLES / 2).div_euclid(SUBSAMPLES).min(limit as i64 - 1);
    (low <= high).then_some((low as usize, high as usize))
}

fn centre(sample: usize) -> i64 {
    sample as i64 * SUBSAMPLES + SUBSAMPLES / 2
}

fn edge(p: &Point, q: &Point, x: i64, y: i64) -> i64 {
    (q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x)
}

/// Triangles binned by bands of rows, which are drawn independently of each other.
pub(crate) struct Bands<'a> {
    points: &'a [Point],
    faces: &'a [[u32; 3]],
    size: [usize; 2],
    rows: usize,
    /// Faces that may cover samples of each band, ascending.
    members: Vec<Vec<u32>>,
}

impl<'a> Bands<'a> {
    /// Bins `faces` into bands of `rows` rows, at least 1. All indices must be below `points.len()`.
    pub(crate) fn new(
        points: &'a [Point],
        faces: &'a [[u32; 3]],
        size: [usize; 2],
        rows: usize,
    ) -> Self {
        let [width, height] = size;
        let mut members = vec![Vec::new(); height.div_ceil(rows)];
        for (index, &face) in faces.iter().enumerate() {
            let corners = face.map(|i| &points[i as usize]);
            if !corners.iter().all(|corner| corner.valid) || span(corners, |p| p.x, width).is_none()
            {
                continue;
            }
            if let Some((first, last)) = span(corners, |p| p.y, height) {
                for bin in &mut members[first / rows..=last / rows] {
                    bin.push(index as u32);
                }
            }
        }
        Self { points, faces, size, rows, members }
    }

    /// True if a band has no triangles.
    pub(crate) fn is_empty(&self, band: usize) -> bool {
        self.members[band].is_empty()
    }

    /// Draws a band with a depth test into `face`, initially [`EMPTY`], and `depth`, initially infinite,
    /// row by row; the first of two triangles of equal depth wins.
    pub(crate) fn draw(&self, band: usize, face: &mut [u32], depth: &mut [f32]) {
        let [width, height] = self.size;
        let top = band * self.rows;
        for &index in &self.members[band] {
            let Some(triangle) = Triangle::new(self.points, self.faces[index as usize]) else {
                continue;
            };
            let corners = triangle.corners.each_ref();
            let Some((first, last)) = span(corners, |p| p.y, height) else { continue };
            for row in first.max(top)..=last.min(top + self.rows - 1) {
                let start = (row - top) * width;
                triangle.scan(row, width, |column, z| {
                    if z < depth[start + column] {
                        depth[start + column] = z;
                        face[start + column] = index;
                    }
                });
            }
        }
    }
}

/// Draws all triangles; the first of two of equal depth wins.
pub(crate) fn rasterise(
    points: &[Point],
    faces: &[[u32; 3]],
    width: usize,
    height: usize,
) -> Visibility {
    let bands = Bands::new(points, faces, [width, height], BAND);
    let mut seen = Visibility {
        face: vec![EMPTY; width * height],
        depth: vec![f32::INFINITY; width * height],
    };
    let size = (BAND * width).max(1);
    seen.face
        .par_chunks_mut(size)
        .zip(seen.depth.par_chunks_mut(size))
        .enumerate()
        .for_each(|(band, (face, depth))| bands.draw(band, face, depth));
    seen
}

/// Perspective-correct barycentric coordinates of the centre of a sample.
pub(crate) fn barycentric(corners: [&Point; 3], column: usize, row: usize) -> [f32; 3] {
    let [a, b, c] = corners;
    let (x, y) = (centre(column), centre(row));
    let weights = [
        edge(b, c, x, y) as f32 * a.inverse_w,
        edge(c, a, x, y) as f32 * b.inverse_w,
        edge(a, b, x, y) as f32 * c.inverse_w,
    ];
    let scale = (weights[0] + weights[1] + weights[2]).recip();
    weights.map(|weight| weight * scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point(x: f32, y: f32, z: f32) -> Point {
        Point {
            x: (x * 256.0).round() as i64,
            y: (y * 256.0).round() as i64,
            z,
            inverse_w: 1.0,
            valid: true,
        }
    }

    fn coverage(points: &[Point], faces: &[[u32; 3]], width: usize, height: usize) -> Vec<u32> {
        let mut count = vec![0; width * height];
        for &face in faces {
            let seen = rasterise(points, &[face], width, height);
            for (count, &face) in count.iter_mut().zip(&seen.face) {
                *count += u32::from(face != EMPTY);
            }
        }
        count
    }

    #[test]
    fn a_square_on_sample_centres_is_covered_once_with_the_top_left_rule() {
        let points = [
            point(2.5, 1.5, 0.5),
            point(6.5, 1.5, 0.5),
            point(6.5, 4.5, 0.5),
            point(2.5, 4.5, 0.5),
        ];
        for faces in [[[0, 1, 2], [0, 2, 3]], [[1, 0, 3], [3, 2, 1]]] {
            let count = coverage(&points, &faces, 9, 7);
            for (i, &count) in count.iter().enumerate() {
                let inside = (2..6).contains(&(i % 9)) && (1..4).contains(&(i / 9));
                assert_eq!(count, u32::from(inside), "column {} row {}", i % 9, i / 9);
            }
        }
    }

    #[test]
    fn the_nearer_triangle_is_seen_in_either_order() {
        let points = [
            point(0.0, 0.0, 0.2),
            point(20.0, 0.0, 0.2),
            point(0.0, 20.0, 0.2),
            point(0.0, 0.0, 0.1),
            point(20.0, 0.0, 0.6),
            point(0.0, 20.0, 0.1),
        ];
        let seen = rasterise(&points, &[[0, 1, 2], [3, 4, 5]], 16, 16);
        let swapped = rasterise(&points, &[[3, 4, 5], [0, 1, 2]], 16, 16);
        // The second plane's depth is 0.1 + x/40: it passes behind the first at x = 4.
        for column in 0..16 {
            let nearer = u32::from(column < 4);
            assert_eq!(seen.face[column], nearer, "column {column}");
            assert_eq!(swapped.face[column], 1 - nearer, "column {column}");
            let depth = if nearer == 1 { 0.1 + (column as f32 + 0.5) / 40.0 } else { 0.2 };
            assert!((seen.depth[column] - depth).abs() < 1e-5);
        }
    }

    #[test]
    fn barycentrics_are_perspective_correct() {
        // An edge from w = 1 to w = 3: half-way in the image is a quarter of the way in space.
        let mut points = [point(0.0, 0.0, 0.0), point(9.0, 0.0, 0.0), point(0.0, 9.0, 0.0)];
        points[1].inverse_w = 1.0 / 3.0;
        points[2].inverse_w = 1.0;
        let [_, b, _] = barycentric([&points[0], &points[1], &points[2]], 4, 0);
        // Affine weights at (4.5, 0.5): a 4/9, b 1/2, c 1/18.
        let expected = (0.5 / 3.0) / (4.0 / 9.0 + 0.5 / 3.0 + 1.0 / 18.0);
        assert!((b - expected).abs() < 1e-5);
    }

    #[test]
    fn points_behind_the_camera_or_not_finite_are_dropped() {
        for clip in [[0.0, 0.0, 0.5, -1.0], [f32::NAN, 0.0, 0.5, 1.0], [1e9, 0.0, 0.5, 1.0]] {
            let points = [Point::project(clip, 8, 8), point(0.0, 0.0, 0.5), point(8.0, 8.0, 0.5)];
            let seen = rasterise(&points, &[[0, 1, 2]], 8, 8);
            assert!(seen.face.iter().all(|&face| face == EMPTY));
        }
    }

    proptest! {
        /// A fan around an inner point tiles its polygon.
        #[test]
        fn a_fan_covers_every_sample_exactly_once(
            centre in (8.0f32..24.0, 8.0f32..24.0),
            radii in prop::collection::vec(20.0f32..60.0, 3..9),
            snap in any::<bool>(),
        ) {
            let round = |v: f32| if snap { v.floor() + 0.5 } else { v };
            let n = radii.len();
            let mut points = vec![point(round(centre.0), round(centre.1), 0.5)];
            for (i, radius) in radii.iter().enumerate() {
                let angle = i as f32 / n as f32 * std::f32::consts::TAU;
                points.push(point(
                    round(centre.0 + 4.0 * radius * angle.cos()),
                    round(centre.1 + 4.0 * radius * angle.sin()),
                    0.5,
                ));
            }
            let faces: Vec<[u32; 3]> =
                (0..n as u32).map(|i| [0, 1 + i, 1 + (i + 1) % n as u32]).collect();
            let count = coverage(&points, &faces, 32, 32);
            prop_assert!(count.iter().all(|&c| c == 1));
        }
    }
}
