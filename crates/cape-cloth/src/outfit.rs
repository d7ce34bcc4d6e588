use cape_core::geometry::{SurfaceIndex, SurfaceMesh};
use glam::DVec3;

use super::{ClothMaterial, ElasticBand, GarmentMesh};

/// Distance beyond the mean of the thicknesses at which an outer garment begins, metres.
const APART: f64 = 0.003;

/// Distance within which an outer garment is moved out of an inner one, metres.
const REACH: f64 = 0.06;

/// A vertex of a waistband, its point on the body by face and barycentric coordinates, and its offset
/// in the face's axes, metres.
pub(super) type AttachedVertex = (u32, u32, [f64; 3], DVec3);

/// Waistbands of garments on the body `rest` that they are sewn for; vertices of the garments follow
/// one another.
pub(super) fn attached_waistbands(
    outfit: &[(&GarmentMesh, &ClothMaterial)],
    rest: &SurfaceMesh,
) -> Vec<AttachedVertex> {
    let at_rest = SurfaceIndex::new(rest);
    let mut first = 0;
    let mut all = Vec::new();
    for (garment, _) in outfit {
        let surface = &garment.surface;
        all.extend(garment.waistband.iter().filter_map(|&v| {
            let at = surface.vertices[v as usize];
            let near = at_rest.closest(at, 0.2)?;
            let off = at_rest.axes(near.face).transpose() * (at - near.point);
            Some((first + v, near.face, near.barycentric, off))
        }));
        first += surface.vertices.len() as u32;
    }
    all
}

/// Shares of hems by vertex, and the elastic of all cuffs; vertices and faces of the garments follow one
/// another.
pub(super) fn reinforcements(outfit: &[(&GarmentMesh, &ClothMaterial)]) -> (Vec<f64>, ElasticBand) {
    let mut hems = Vec::new();
    let mut cuffs = ElasticBand::default();
    let mut first = 0;
    for (garment, _) in outfit {
        hems.extend(garment.hem_shares());
        let own = garment.elastic_cuffs();
        let faces = own.faces.iter().map(|&(face, along)| (first + face, along));
        cuffs = ElasticBand { faces: cuffs.faces.into_iter().chain(faces).collect(), ..own };
        first += garment.surface.faces.len() as u32;
    }
    (hems, cuffs)
}

/// Vertices of garments from the inner to the outer one, each moved outside the ones before it, metres.
pub(super) fn dressed(sheets: &[(&SurfaceMesh, &ClothMaterial)]) -> Vec<DVec3> {
    let mut all: Vec<DVec3> = Vec::new();
    let mut inner: Vec<(SurfaceIndex, Vec<bool>, f64)> = Vec::new();
    for (surface, material) in sheets {
        let mut moved = (*surface).clone();
        for (index, boundary, thickness) in &inner {
            let gap = 0.5 * (thickness + material.thickness) + APART;
            for x in &mut moved.vertices {
                let Some(near) = index.closest(*x, REACH) else { continue };
                // Beyond the edge of the inner garment there is nothing to be outside of.
                let corners = index.surface().faces[near.face as usize];
                let held = corners.iter().zip(near.barycentric).filter(|(_, w)| *w > 1e-9);
                if held.clone().all(|(&v, _)| boundary[v as usize]) && near.signed_distance > 0.0 {
                    continue;
                }
                if near.signed_distance < gap {
                    *x += near.outward * (gap - near.signed_distance);
                }
            }
        }
        all.extend(&moved.vertices);
        let boundary = moved.boundary();
        inner.push((SurfaceIndex::new(&moved), boundary, material.thickness));
    }
    all
}

/// A garment at the positions of its vertices, metres.
pub(super) fn part(positions: &[DVec3], surface: &SurfaceMesh) -> SurfaceMesh {
    SurfaceMesh { vertices: positions.to_vec(), faces: surface.faces.clone() }
}
