//! Sampled clothes on posed bodies, and their pictures.

use burn::tensor::{Device, Tensor, TensorData};
use cape_core::{ClothedSmpl, ClothingMask, Mesh, Outfit, Smpl, SmplInput, SmplModel};
use cape_render::{Image, Object, Style, View, colour_of, portrait};
use cape_train::Run;
use ndarray::{Array2, Array3, ArrayView2, Axis, s};

use crate::{
    error::{Error, Result},
    pose::Pose,
};

/// Bodies posed at a time.
const BATCH: usize = 16;
/// Displacements from here, metres, look like cloth, and from [`CLOTH`] on wholly so.
const SKIN: f32 = 0.0025;
const CLOTH: f32 = 0.0038;
/// How often these distances are averaged over neighbours.
const SMOOTHINGS: usize = 5;
/// Pelvis, spine and collars: under cloth in every outfit.
const TRUNK: [usize; 6] = [0, 3, 6, 9, 13, 14];
/// Joints that move legs, for telling trousers from shirt.
const LEGS: [usize; 8] = [1, 2, 4, 5, 7, 8, 10, 11];

const SKIN_COLOUR: [f32; 3] = [0.83, 0.69, 0.60];
const TROUSERS: [f32; 3] = [0.27, 0.31, 0.40];

/// A body in clothes.
#[derive(Debug, Clone)]
pub(crate) struct Dressed {
    /// The surface, posed, metres.
    pub(crate) mesh: Mesh,
    /// sRGB from 0 to 1, `[vertices, 3]`.
    pub(crate) colours: Vec<[f32; 3]>,
    /// Lengths of the displacements at clothing vertices, metres, `[vertices]`.
    pub(crate) distances: Vec<f32>,
}

/// What to dress.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Request {
    pub(crate) outfit: Outfit,
    pub(crate) pose: Pose,
    /// Row of the codes.
    pub(crate) code: usize,
}

/// Decodes `codes` `[n, latent]` for each request and poses the clothed bodies; joints follow the
/// body, displacements apply at clothing vertices. `each` gets every result in turn.
pub(crate) fn dress(
    run: &Run,
    codes: &Array2<f32>,
    betas: &[f32],
    requests: &[Request],
    mut each: impl FnMut(usize, Dressed) -> Result,
) -> Result {
    let wearer = Wearer::new(run)?;
    for (chunk_index, chunk) in requests.chunks(BATCH).enumerate() {
        let rows: Vec<usize> = chunk.iter().map(|request| request.code).collect();
        let z = codes.select(Axis(0), &rows);
        let poses: Vec<Pose> = chunk.iter().map(|request| request.pose).collect();
        let outfits: Vec<Outfit> = chunk.iter().map(|request| request.outfit).collect();
        let displacement = run.decode(&z, &poses, &outfits)?;
        let bodies = wearer.wear(betas, &outfits, &poses, &displacement)?;
        for (index, body) in bodies.into_iter().enumerate() {
            each(chunk_index * BATCH + index, body)?;
        }
    }
    Ok(())
}

/// A run's body, ready to be dressed.
pub(crate) struct Wearer<'a> {
    run: &'a Run,
    mask: ClothingMask,
    clothed: ClothedSmpl,
}

impl<'a> Wearer<'a> {
    pub(crate) fn new(run: &'a Run) -> Result<Self> {
        let mask = ClothingMask::from_indices(run.body().vertices(), run.clothing())?;
        let smpl = Smpl::new(run.body(), run.device())?;
        Ok(Self { run, clothed: ClothedSmpl::new(smpl).with_mask(&mask)?, mask })
    }

    /// Bodies in given clothes: displacements `[n, vertices, 3]` in metres, of which those at
    /// clothing vertices apply; an outfit and a pose for each.
    pub(crate) fn wear(
        &self,
        betas: &[f32],
        outfits: &[Outfit],
        poses: &[Pose],
        displacement: &Array3<f32>,
    ) -> Result<Vec<Dressed>> {
        let (body, mask) = (self.run.body(), &self.mask);
        let vertices = posed(&self.clothed, betas, poses, Some(displacement), self.run.device())?;
        let bodies = vertices.axis_iter(Axis(0)).zip(displacement.axis_iter(Axis(0)));
        Ok(bodies
            .zip(outfits)
            .map(|((vertices, worn), &outfit)| Dressed {
                mesh: mesh(body, vertices),
                colours: colours(body, mask, worn, outfit),
                distances: distances(mask, worn),
            })
            .collect())
    }
}

/// The body without clothes.
pub(crate) fn bare(
    body: &SmplModel,
    betas: &[f32],
    pose: &Pose,
    device: &Device,
) -> Result<Dressed> {
    let clothed = ClothedSmpl::new(Smpl::new(body, device)?);
    let vertices = posed(&clothed, betas, &[*pose], None, device)?;
    Ok(Dressed {
        mesh: mesh(body, vertices.slice(s![0, .., ..])),
        colours: vec![SKIN_COLOUR; body.vertices()],
        distances: vec![0.0; body.vertices()],
    })
}

fn posed(
    clothed: &ClothedSmpl,
    betas: &[f32],
    poses: &[Pose],
    displacement: Option<&Array3<f32>>,
    device: &Device,
) -> Result<Array3<f32>> {
    let (n, v) = (poses.len(), clothed.body().vertices());
    let rows = |values: Vec<f32>, width: usize| {
        Tensor::<2>::from_data(TensorData::new(values, [n, width]), device)
    };
    let worn = displacement.map(|array| {
        let values: Vec<f32> = array.iter().copied().collect();
        Tensor::<3>::from_data(TensorData::new(values, [n, v, 3]), device)
    });
    let output = clothed.forward(SmplInput {
        betas: rows(betas.repeat(n), betas.len()),
        pose: cape_core::Pose::AxisAngle(rows(poses.as_flattened().to_vec(), 72)),
        transl: rows(vec![0.0; 3 * n], 3),
        displacement: worn,
    })?;
    let values = output.vertices.into_data().convert::<f32>().try_into_vec::<f32>();
    let values = values.map_err(|_| Error::message("the device returned no vertices"))?;
    if values.iter().any(|x| !x.is_finite()) {
        return Err(Error::message("the model decodes vertices that are not finite"));
    }
    Array3::from_shape_vec((n, v, 3), values).map_err(|error| Error::message(error.to_string()))
}

fn mesh(body: &SmplModel, vertices: ArrayView2<f32>) -> Mesh {
    let vertices = vertices.rows().into_iter().map(|v| [v[0], v[1], v[2]]).collect();
    Mesh { vertices, faces: body.faces.clone() }
}

fn distances(mask: &ClothingMask, displacement: ArrayView2<f32>) -> Vec<f32> {
    let rows = displacement.rows().into_iter().zip(mask.covered());
    rows.map(|(d, &covered)| if covered { d.dot(&d).sqrt() } else { 0.0 }).collect()
}

/// Colours that show where there is cloth: on the trunk, and where the surface leaves the skin.
fn colours(
    body: &SmplModel,
    mask: &ClothingMask,
    displacement: ArrayView2<f32>,
    outfit: Outfit,
) -> Vec<[f32; 3]> {
    let distance = displacement.rows().into_iter().map(|d| d.dot(&d).sqrt()).collect();
    let share = |joints: &[usize]| {
        let of = |weights: ndarray::ArrayView1<f64>| {
            joints.iter().filter_map(|&joint| weights.get(joint)).sum::<f64>() as f32
        };
        smoothed(body, body.weights.rows().into_iter().map(of).collect())
    };
    let (distance, legs, trunk) = (smoothed(body, distance), share(&LEGS), share(&TRUNK));
    let vertex = |(&covered, ((&distance, &leg), &trunk)): (&bool, ((&f32, &f32), &f32))| {
        if !covered {
            return SKIN_COLOUR;
        }
        let garment = mix(shirt_colour(outfit), TROUSERS, ramp(leg, 0.42, 0.58));
        let cloth = ramp(distance, SKIN, CLOTH).max(ramp(trunk, 0.5, 0.8));
        mix(SKIN_COLOUR, garment, cloth)
    };
    mask.covered().iter().zip(distance.iter().zip(&legs).zip(&trunk)).map(vertex).collect()
}

/// Averages over neighbours a few times, so that a fold that touches the skin is no hole.
fn smoothed(body: &SmplModel, mut values: Vec<f32>) -> Vec<f32> {
    for _ in 0..SMOOTHINGS {
        let mut sums: Vec<(f32, f32)> = values.iter().map(|&value| (value, 1.0)).collect();
        for face in &body.faces {
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                let (a, b) = (face[a] as usize, face[b] as usize);
                sums[a] = (sums[a].0 + values[b], sums[a].1 + 1.0);
            }
        }
        values = sums.into_iter().map(|(sum, count)| sum / count).collect();
    }
    values
}

/// From 0 at `low` to 1 at `high`.
fn ramp(value: f32, low: f32, high: f32) -> f32 {
    ((value - low) / (high - low)).clamp(0.0, 1.0)
}

const fn shirt_colour(outfit: Outfit) -> [f32; 3] {
    match outfit {
        Outfit::ShortLong => [0.36, 0.56, 0.67],
        Outfit::ShortShort => [0.72, 0.42, 0.34],
        Outfit::LongShort => [0.44, 0.58, 0.43],
        Outfit::LongLong => [0.66, 0.57, 0.36],
    }
}

fn mix(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * t)
}

impl Dressed {
    /// A picture from the given side.
    pub(crate) fn picture(&self, view: View, width: u32, height: u32) -> Result<Image> {
        let style = Style { width, height, ..Style::default() };
        Ok(portrait(Object::new(&self.mesh).coloured(&self.colours), view, &style)?)
    }

    /// Colours as 8-bit numbers.
    pub(crate) fn colours_8_bit(&self) -> Vec<[u8; 3]> {
        self.colours.iter().copied().map(eight_bit).collect()
    }

    /// Colours by the length of the displacement, up to `longest` metres.
    pub(crate) fn colour_by_distance(&mut self, longest: f32) {
        self.colours = self.distances.iter().map(|length| colour_of(length / longest)).collect();
    }
}

/// sRGB from 0 to 1 as 8-bit numbers.
pub(crate) fn eight_bit(colour: [f32; 3]) -> [u8; 3] {
    colour.map(|x| (255.0 * x.clamp(0.0, 1.0)).round() as u8)
}
