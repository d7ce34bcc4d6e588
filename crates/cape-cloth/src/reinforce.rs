use cape_core::geometry::SurfaceMesh;
use glam::DVec3;

use super::GarmentMesh;

/// Distance from the end of a sleeve or leg within which cloth is of the cuff, metres.
pub(super) const CUFF: f64 = 0.04;

/// Circumference of a cuff's elastic at rest, relative to the cuff as it is sewn.
const GATHER: f64 = 0.8;

/// Stiffness of a cuff's elastic around the limb, N/m: about 3 N over the whole cuff as it is sewn.
const ELASTIC: f64 = 250.0;

/// Elastic sewn onto faces of a cloth, which pulls along one direction of each.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ElasticBand {
    /// Faces, and the direction of pull in the plane of each at rest, a unit vector.
    pub faces: Vec<(u32, DVec3)>,
    /// Length at rest relative to the cloth's.
    pub ratio: f64,
    /// Force per width and Green strain of the elastic, N/m.
    pub stiffness: f64,
}

impl GarmentMesh {
    /// Share of each vertex's cloth that lies in a hem, where the cloth is double, 0 to 1, `[vertices]`.
    /// All edges of the garment have hems ([`Garment::hem`](super::Garment::hem)).
    pub fn hem_shares(&self) -> Vec<f64> {
        let surface = &self.surface;
        let (width, edge) = (self.garment.hem, self.garment.resolution);
        if width == 0.0 {
            return vec![0.0; surface.vertices.len()];
        }
        let sides = boundary_edges(surface);
        let share = |x: &DVec3| {
            let off = nearest(&sides, *x).map_or(f64::INFINITY, |(_, off)| off);
            ((width + 0.5 * edge - off) / edge).clamp(0.0, 1.0)
        };
        surface.vertices.iter().map(share).collect()
    }

    /// Elastic of the cuffs ([`Garment::cuffs`](super::Garment::cuffs)) around the limbs; without faces
    /// if there are none.
    pub fn elastic_cuffs(&self) -> ElasticBand {
        let surface = &self.surface;
        let on_cuff = |v: &u32| self.cuffs.binary_search(v).is_ok();
        let sides: Vec<[DVec3; 2]> = boundary_edges(surface);
        let faces = (0..surface.faces.len()).filter(|&f| surface.faces[f].iter().all(on_cuff));
        let around = faces.filter_map(|face| {
            let [a, b, c] = surface.corners(face);
            let normal = (b - a).cross(c - a).try_normalize()?;
            let ([from, to], _) = nearest(&sides, (a + b + c) / 3.0)?;
            let along = to - from;
            Some((face as u32, (along - normal * along.dot(normal)).try_normalize()?))
        });
        ElasticBand { faces: around.collect(), ratio: GATHER, stiffness: ELASTIC }
    }
}

/// Ends of the edges of the boundary, metres.
fn boundary_edges(surface: &SurfaceMesh) -> Vec<[DVec3; 2]> {
    let mut sides = Vec::new();
    for (corners, across) in surface.faces.iter().zip(surface.neighbours()) {
        for side in (0..3).filter(|&side| across[side].is_none()) {
            let ends = [corners[side], corners[(side + 1) % 3]];
            sides.push(ends.map(|v| surface.vertices[v as usize]));
        }
    }
    sides
}

/// Segment nearest to a point and its distance, metres.
fn nearest(segments: &[[DVec3; 2]], x: DVec3) -> Option<([DVec3; 2], f64)> {
    let off = |&[a, b]: &[DVec3; 2]| {
        let along = b - a;
        let t =
            ((x - a).dot(along) / along.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        x.distance(a + along * t)
    };
    let all = segments.iter().map(|segment| (*segment, off(segment)));
    all.min_by(|a, b| a.1.total_cmp(&b.1))
}
