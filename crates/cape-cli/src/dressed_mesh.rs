//! Dressed bodies in colours, and their pictures.

use cape_core::{Mesh, Outfit};
use cape_infer::{BodySpec, ClothedBody, GarmentColours, Run, SKIN_COLOUR, batches};
use cape_render::{Image, Object, Style, Texture, View, colormap, portrait};
use ndarray::{Array2, Array3, ArrayView2, Axis};

use crate::error::Result;

/// A dressed body.
#[derive(Debug, Clone)]
pub(crate) struct DressedMesh {
    /// Posed surface, metres.
    pub(crate) mesh: Mesh,
    /// sRGB from 0 to 1, `[vertices, 3]`.
    pub(crate) colours: Vec<[f32; 3]>,
    /// Lengths of the displacements at clothing vertices, metres, `[vertices]`.
    pub(crate) distances: Vec<f32>,
}

/// Dresses each of the bodies `wearers` by its row of `codes` `[n, latent]` and passes it to `each`.
pub(crate) fn dress(
    run: &Run,
    codes: &Array2<f32>,
    wearers: &[BodySpec],
    mut each: impl FnMut(usize, DressedMesh) -> Result,
) -> Result {
    let painter = DressedRenderer::new(run);
    for rows in batches(wearers.len()) {
        let bodies = &wearers[rows.clone()];
        let codes = codes.slice(ndarray::s![rows.clone(), ..]).to_owned();
        let clothed = run.dress_with_displacements(&codes, bodies)?;
        for (index, (clothed, body)) in rows.zip(clothed.into_iter().zip(bodies)) {
            let ClothedBody { mesh, displacement } = clothed;
            each(index, painter.coloured(mesh, displacement.view(), body.outfit))?;
        }
    }
    Ok(())
}

/// Colours dressed bodies of a run.
pub(crate) struct DressedRenderer<'a> {
    run: &'a Run,
    colours: GarmentColours,
}

impl<'a> DressedRenderer<'a> {
    pub(crate) fn new(run: &'a Run) -> Self {
        Self { run, colours: GarmentColours::new(run.body(), run.mask()) }
    }

    /// Bodies with displacements `[n, vertices, 3]`, metres.
    pub(crate) fn pose_clothed(
        &self,
        displacement: &Array3<f32>,
        wearers: &[BodySpec],
    ) -> Result<Vec<DressedMesh>> {
        let meshes = self.run.pose_clothed(displacement, wearers)?;
        let worn = displacement.axis_iter(Axis(0)).zip(wearers);
        Ok(meshes
            .into_iter()
            .zip(worn)
            .map(|(mesh, (worn, wearer))| self.coloured(mesh, worn, wearer.outfit))
            .collect())
    }

    /// A mesh with the colours of its displacements `[vertices, 3]`, metres.
    fn coloured(&self, mesh: Mesh, displacement: ArrayView2<f32>, outfit: Outfit) -> DressedMesh {
        DressedMesh {
            mesh,
            colours: self.colours.of(displacement, outfit),
            distances: distances(self.run.mask().covered(), displacement),
        }
    }
}

/// Bodies without clothing.
pub(crate) fn unclothed_meshes(run: &Run, wearers: &[BodySpec]) -> Result<Vec<DressedMesh>> {
    let count = run.body().vertices();
    let bodies = run.pose_unclothed(wearers)?.into_iter();
    Ok(bodies
        .map(|mesh| DressedMesh {
            mesh,
            colours: vec![SKIN_COLOUR; count],
            distances: vec![0.0; count],
        })
        .collect())
}

fn distances(covered: &[bool], displacement: ArrayView2<f32>) -> Vec<f32> {
    let rows = displacement.rows().into_iter().zip(covered);
    rows.map(|(d, &covered)| if covered { d.dot(&d).sqrt() } else { 0.0 }).collect()
}

impl DressedMesh {
    /// Picture from the given side, in vertex colours or with a texture.
    pub(crate) fn picture(&self, from: View, size: [u32; 2], on: Option<Texture>) -> Result<Image> {
        let style = Style { width: size[0], height: size[1], ..Style::default() };
        let object = Object::new(&self.mesh);
        let object = match on {
            Some(texture) => object.with_texture(texture),
            None => object.with_colours(&self.colours),
        };
        Ok(portrait(object, from, &style)?)
    }

    /// Colours as 8-bit numbers.
    pub(crate) fn colours_8_bit(&self) -> Vec<[u8; 3]> {
        self.colours.iter().copied().map(eight_bit).collect()
    }

    /// Colours vertices by the length of their displacement, up to `longest` metres.
    pub(crate) fn colour_by_distance(&mut self, longest: f32) {
        self.colours = self.distances.iter().map(|length| colormap(length / longest)).collect();
    }
}

/// sRGB from 0 to 1 as 8-bit numbers.
pub(crate) fn eight_bit(colour: [f32; 3]) -> [u8; 3] {
    colour.map(|x| (255.0 * x.clamp(0.0, 1.0)).round() as u8)
}
