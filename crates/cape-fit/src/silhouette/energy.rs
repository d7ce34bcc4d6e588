//! Silhouette term `E_S` (CAPE eq. 10).
//!
//! `E_S` sums the Manhattan distances of the pixels of the rendered silhouette to the silhouette of
//! the image, and vice versa; pixels in both silhouettes contribute nothing. Its derivative matches
//! pixels with points of the surface instead of using a differentiable renderer: a rendered pixel
//! is the visible surface point, at which the distance field is sampled; a pixel of the image is
//! matched with the nearest point of the rendered outline, on the occluding contour. Sliding along
//! the surface does not move the contour to first order, so the second sum has the exact
//! derivative; the first omits the change of the area of each rendered point, which is small while
//! the silhouettes are close. Surfaces that have moved far are matched again.
//!
//! Pixels of occluders, and everything outside the image, count neither way: a rendered pixel there
//! costs nothing, so that elsewhere its distance is that to the nearest pixel of the person, of an
//! occluder or outside the image; pixels of the image's silhouette under an occluder are left out.
//!
//! [`SilhouetteEnergy::with_softness`] compares the coverage of a [soft
//! rendering](super::render_softly) instead: the derivative is exact without matching, but vanishes
//! beyond a few pixels.

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::{
    Mask, SurfacePoint,
    distance::{FreeDistance, manhattan},
    soft::{check_softness, draw},
    surface::render,
};
use crate::{Error, PinholeCamera, Result};

/// Radius within which the absolute value of a coordinate difference is rounded, pixels: the
/// derivative of
/// |d| is discontinuous at 0.
const ROUNDING: f64 = 0.5;

/// Silhouette of an image at one scale, for comparison with surfaces.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_fit::{PinholeCamera, silhouette::{SilhouetteEnergy, render}};
/// use glam::DVec3;
///
/// // A surface matches its own silhouette; a translated one does not.
/// let camera = PinholeCamera::new(100, 100, Some(100.0))?;
/// let (vertices, faces) = square(1.0);
/// let mask = render(&vertices, &faces, &camera)?.mask().clone();
/// let energy = SilhouetteEnergy::new(&camera, &mask, None, 100, 0.02)?;
/// let mut gradient = vec![DVec3::ZERO; 4];
/// let terms = energy.match_surface(&vertices, &faces)?.evaluate(&vertices, 1.0, &mut gradient);
/// assert!(terms.total() < 1e-6);
/// let moved: Vec<DVec3> = vertices.iter().map(|&vertex| vertex + 0.2 * DVec3::X).collect();
/// let terms = energy.match_surface(&moved, &faces)?.evaluate(&moved, 1.0, &mut gradient);
/// assert!(terms.rendered > 1e-3 && terms.image > 1e-3);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct SilhouetteEnergy {
    camera: PinholeCamera,
    /// Visible pixels of the person.
    target: Mask,
    /// Pixels that the surface may cover: those of the person and of occluders.
    free: Mask,
    distance: FreeDistance,
    /// Width of a pixel at the distance of the person, metres, divided by the area of the
    /// silhouette, pixels.
    scale: f64,
    /// Width of soft edges, pixels; `None` compares distances.
    softness: Option<f64>,
}

/// Both directions of `E_S` (CAPE eq. 10), divided by the area of the image's silhouette, metres at
/// the distance of the person.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct SilhouetteTerms {
    /// Sum over the rendered silhouette of the distances to the image's silhouette.
    pub rendered: f64,
    /// Sum over the image's silhouette of the distances to the rendered silhouette.
    pub image: f64,
}

impl SilhouetteTerms {
    /// Sum of both directions, `E_S`.
    pub fn total(&self) -> f64 {
        self.rendered + self.image
    }
}

/// A surface matched with the silhouette of the image.
#[derive(Debug, Clone)]
pub struct SilhouetteMatch<'a> {
    energy: &'a SilhouetteEnergy,
    /// Visible surface points, one for each rendered pixel.
    rendered: Vec<SurfacePoint>,
    /// Pixels of the image's silhouette outside the rendered one, and the nearest contour points.
    image: Vec<(DVec2, SurfacePoint)>,
    /// Faces of the surface for soft silhouettes; empty otherwise.
    faces: Vec<[u32; 3]>,
}

impl SilhouetteEnergy {
    /// Silhouette `mask` of an image, scaled to at most `side` pixels, without the pixels of
    /// `occluders`, which count neither way; `pixel` is the width of a pixel of `mask` at the
    /// distance of the person, metres.
    ///
    /// # Errors
    /// If the masks have another size than the camera's image, or the person covers nothing or
    /// everything at this scale.
    pub fn new(
        camera: &PinholeCamera,
        mask: &Mask,
        occluders: Option<&Mask>,
        side: u32,
        pixel: f64,
    ) -> Result<Self> {
        mask.check(camera)?;
        let small = camera.downscaled_to(side);
        let resize = |mask: &Mask| mask.resize(small.width(), small.height());
        let (target, free) = if let Some(occluders) = occluders {
            let free = resize(&mask.union(occluders)?);
            let target = resize(&mask.without(occluders)?);
            if target.area() == 0 {
                return Err(Error::Observation(
                    "the occluders hide the whole person: nothing of the mask is left".into(),
                ));
            }
            (target, free)
        } else {
            let target = resize(mask);
            target.check(&small)?;
            (target.clone(), target)
        };
        let pixel = pixel * camera.focal() / small.focal();
        let scale = pixel / target.area() as f64;
        let distance = FreeDistance::new(&free)?;
        Ok(Self { distance, free, camera: small, target, scale, softness: None })
    }

    /// The same silhouette, compared by the soft coverage `A` of each pixel with edges `softness`
    /// pixels wide: `Σ (A − mask)²`, in the same units, so that the values agree for an outline
    /// that is off by two pixels.
    ///
    /// # Errors
    /// If the softness is not positive.
    pub fn with_softness(self, softness: f64) -> Result<Self> {
        check_softness(softness)?;
        Ok(Self { softness: Some(softness), ..self })
    }

    /// Silhouette of the image at the scale of the comparison.
    pub fn target(&self) -> &Mask {
        &self.target
    }

    /// Camera at the scale of the comparison.
    pub fn camera(&self) -> &PinholeCamera {
        &self.camera
    }

    /// Matches a surface (vertices in metres, `[V]`, triangles `[F]`) with the silhouette in both
    /// directions.
    ///
    /// # Errors
    /// If the surface is outside the image.
    pub fn match_surface(
        &self,
        vertices: &[DVec3],
        faces: &[[u32; 3]],
    ) -> Result<SilhouetteMatch<'_>> {
        let rendering = render(vertices, faces, &self.camera)?;
        if rendering.mask().area() == 0 {
            return Err(Error::Failed("the body has left the image".into()));
        }
        if self.softness.is_some() {
            let (rendered, image) = (Vec::new(), Vec::new());
            return Ok(SilhouetteMatch { energy: self, rendered, image, faces: faces.to_vec() });
        }
        let nearest = manhattan(rendering.mask());
        let point = |pixel: usize| rendering.point(pixel, vertices, faces);
        let count = self.target.covered().len();
        let width = self.target.width() as usize;
        let pulled = |pixel: usize| {
            let centre = DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
            let outside = self.target.covered()[pixel] && nearest.distance()[pixel] > 0.0;
            outside.then(|| Some((centre, point(nearest.site()[pixel] as usize)?))).flatten()
        };
        Ok(SilhouetteMatch {
            energy: self,
            rendered: (0..count).filter_map(point).collect(),
            image: (0..count).filter_map(pulled).collect(),
            faces: Vec::new(),
        })
    }
}

impl SilhouetteMatch<'_> {
    /// Terms of the surface at `vertices`, metres, `[V]`; `weight` times the gradient is added to
    /// `gradient` `[V]`.
    pub fn evaluate(
        &self,
        vertices: &[DVec3],
        weight: f64,
        gradient: &mut [DVec3],
    ) -> SilhouetteTerms {
        if let Some(softness) = self.energy.softness {
            return self.evaluate_softly(vertices, softness, weight, gradient);
        }
        let SilhouetteEnergy { camera, distance: free, scale, .. } = self.energy;
        let mut terms = SilhouetteTerms::default();
        let mut pull = |point: &SurfacePoint, at: DVec3, by_pixel: DVec2| {
            if by_pixel != DVec2::ZERO {
                point.pull_back(camera.pull_back(at, by_pixel * (weight * scale)), gradient);
            }
        };
        for point in &self.rendered {
            let at = point.at(vertices);
            let pixel = camera.project(at);
            let (distance, slope) = free.sample(pixel.x, pixel.y);
            terms.rendered += scale * distance;
            pull(point, at, DVec2::from_array(slope));
        }
        for (target, point) in &self.image {
            let at = point.at(vertices);
            let off = camera.project(at) - *target;
            let [x, y] = [off.x, off.y].map(rounded);
            terms.image += scale * (x.0 + y.0);
            pull(point, at, DVec2::new(x.1, y.1));
        }
        terms
    }

    fn evaluate_softly(
        &self,
        vertices: &[DVec3],
        softness: f64,
        weight: f64,
        gradient: &mut [DVec3],
    ) -> SilhouetteTerms {
        let SilhouetteEnergy { camera, target, free, scale, .. } = self.energy;
        let rendering = draw(vertices, &self.faces, camera, softness);
        let mut terms = SilhouetteTerms::default();
        let mut by_coverage = Vec::with_capacity(target.covered().len());
        let pixels = target.covered().iter().zip(free.covered());
        for (&found, (&wanted, &free)) in rendering.coverage().iter().zip(pixels) {
            // Occluders count neither way.
            let off = if free && !wanted { 0.0 } else { found - f64::from(wanted) };
            let term = if wanted { &mut terms.image } else { &mut terms.rendered };
            *term += scale * off * off;
            by_coverage.push(2.0 * weight * scale * off);
        }
        rendering.pull_back(vertices, &by_coverage, gradient);
        terms
    }
}

/// Rounded absolute value `√(d² + r²) − r`, and its derivative.
fn rounded(d: f64) -> (f64, f64) {
    let size = d.hypot(ROUNDING);
    (size - ROUNDING, d / size)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{BODY, assert_gradient};

    type Change = fn(f64) -> (Vec<DVec3>, Vec<[u32; 3]>);

    /// The synthetic body, raised, scaled in width and translated along x.
    fn body(width: f64, shift: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let body = &*BODY;
        let rows = body.v_template.rows().into_iter();
        let vertices =
            rows.map(|v| DVec3::new(v[0] * width + shift, v[1] + 0.3, v[2] * width - 2.6));
        (vertices.collect(), body.faces.clone())
    }

    fn camera() -> PinholeCamera {
        PinholeCamera::new(160, 160, None).unwrap()
    }

    fn energy(vertices: &[DVec3], faces: &[[u32; 3]]) -> SilhouetteEnergy {
        occluded(vertices, faces, None)
    }

    fn occluded(
        vertices: &[DVec3],
        faces: &[[u32; 3]],
        occluders: Option<&Mask>,
    ) -> SilhouetteEnergy {
        let camera = camera();
        let mask = render(vertices, faces, &camera).unwrap().mask().clone();
        SilhouetteEnergy::new(&camera, &mask, occluders, 160, 0.01).unwrap()
    }

    /// A table in front of one leg and a post in front of an arm.
    fn furniture() -> Mask {
        let covered = (0..160 * 160).map(|at| {
            let (x, y) = (at % 160, at / 160);
            (x > 85 && (105..130).contains(&y)) || (40..52).contains(&x)
        });
        Mask::new(160, 160, covered.collect()).unwrap()
    }

    /// Both sums of CAPE eq. 10 by brute force; occluders and the outside of the image count neither
    /// way.
    fn sums(energy: &SilhouetteEnergy, vertices: &[DVec3], faces: &[[u32; 3]]) -> [f64; 2] {
        let rendered = render(vertices, faces, energy.camera()).unwrap().mask().clone();
        let covered = |mask: &Mask| -> Vec<[i64; 2]> {
            let width = i64::from(mask.width());
            (0..mask.covered().len())
                .filter(|&at| mask.covered()[at])
                .map(|at| [at as i64 % width, at as i64 / width])
                .collect()
        };
        let [a, b, free] = [&rendered, energy.target(), &energy.free].map(covered);
        let to = |p: &[i64; 2], others: &[[i64; 2]]| {
            others.iter().map(|q| (p[0] - q[0]).abs() + (p[1] - q[1]).abs()).min().unwrap()
        };
        let outside = |p: &[i64; 2]| (p[0] + 1).min(p[1] + 1).min(160 - p[0]).min(160 - p[1]);
        let first: i64 = a.iter().map(|p| to(p, &free).min(outside(p))).sum();
        let second: i64 = b.iter().map(|p| to(p, &a)).sum();
        [first, second].map(|sum| sum as f64 * energy.scale)
    }

    #[test]
    fn values_are_the_papers_sums() {
        let (truth, faces) = body(1.0, 0.0);
        let (cut_off, _) = body(1.0, 1.1);
        let tables = furniture();
        let [plain, cut, occluded] = [
            energy(&truth, &faces),
            energy(&cut_off, &faces),
            occluded(&truth, &faces, Some(&tables)),
        ];
        assert!(occluded.target.area() < plain.target.area());
        for (energy, width, shift) in [
            (&plain, 1.1, 0.0),
            (&plain, 0.9, 0.0),
            (&plain, 1.0, 0.15),
            (&plain, 0.8, -0.2),
            (&cut, 1.0, 1.0),
            (&cut, 1.1, 1.25),
            (&occluded, 1.0, 0.15),
            (&occluded, 1.1, -0.1),
        ] {
            let (vertices, _) = body(width, shift);
            let matched = energy.match_surface(&vertices, &faces).unwrap();
            let terms = matched.evaluate(&vertices, 0.0, &mut vec![DVec3::ZERO; vertices.len()]);
            let expected = sums(energy, &vertices, &faces);
            assert!((terms.rendered - expected[0]).abs() < 0.03 * expected[0] + 1e-6, "{terms:?}");
            // Rounding subtracts at most ROUNDING in each of two coordinates.
            let taken = 2.0 * ROUNDING * energy.scale * matched.image.len() as f64;
            assert!(terms.image <= 1.001 * expected[1] + 1e-6, "{terms:?} {expected:?}");
            assert!(terms.image >= expected[1] - taken, "{terms:?} {expected:?}");
        }
        for (energy, truth) in [(&plain, &truth), (&cut, &cut_off), (&occluded, &truth)] {
            let perfect = energy.match_surface(truth, &faces).unwrap();
            let terms = perfect.evaluate(truth, 0.0, &mut vec![DVec3::ZERO; truth.len()]);
            assert!(terms.total() < 1e-5, "{terms:?}");
        }
    }

    /// Pixels under occluders and outside the image change neither value nor gradient.
    #[test]
    fn hidden_pixels_count_neither_way() {
        let (truth, faces) = body(1.0, 0.0);
        let tables = furniture();
        let mask = render(&truth, &faces, &camera()).unwrap().mask().clone();
        let new =
            |mask: &Mask| SilhouetteEnergy::new(&camera(), mask, Some(&tables), 160, 0.01).unwrap();
        let (shifted, _) = body(1.05, 0.1);
        let value = |energy: &SilhouetteEnergy| {
            let mut forces = vec![DVec3::ZERO; shifted.len()];
            let matched = energy.match_surface(&shifted, &faces).unwrap();
            (matched.evaluate(&shifted, 1.0, &mut forces), forces)
        };
        // The mask of the person with or without what is hidden.
        let [visible, whole] =
            [new(&mask.without(&tables).unwrap()), new(&mask.union(&tables).unwrap())];
        assert_eq!(value(&visible), value(&whole));
        let [visible, whole] = [visible, whole].map(|energy| energy.with_softness(1.0).unwrap());
        assert_eq!(value(&visible), value(&whole));
        let everything = Mask::new(160, 160, vec![true; 160 * 160]).unwrap();
        let refused = SilhouetteEnergy::new(&camera(), &mask, Some(&everything), 160, 0.01);
        assert!(refused.unwrap_err().to_string().contains("hide the whole person"));
    }

    #[test]
    fn gradients_of_matched_surfaces_agree_with_differences() {
        let (truth, faces) = body(1.0, 0.0);
        check_matched(&energy(&truth, &faces), 0.13);
        check_matched(&occluded(&truth, &faces, Some(&furniture())), 0.13);
        // Cut off by the border.
        let (truth, _) = body(1.0, 1.1);
        check_matched(&energy(&truth, &faces), 1.21);
    }

    fn check_matched(energy: &SilhouetteEnergy, shift: f64) {
        let (vertices, faces) = body(1.05, shift);
        let matched = energy.match_surface(&vertices, &faces).unwrap();
        // Directions: each vertex along its own pseudo-random vector.
        let mode = |which: usize, i: usize| {
            let phase = (i * (which + 3)) as f64 * 0.7;
            DVec3::new(phase.sin(), (1.3 * phase).cos(), (0.4 * phase).sin()) * 0.2
        };
        let moved = |x: &[f64]| -> Vec<DVec3> {
            let change =
                |i: usize| x.iter().enumerate().map(|(w, x)| mode(w, i) * *x).sum::<DVec3>();
            vertices.iter().enumerate().map(|(i, v)| *v + change(i)).collect()
        };
        let value = |x: &[f64], gradient: &mut [DVec3]| {
            matched.evaluate(&moved(x), 2.0, gradient).total() * 2.0
        };
        // As matched, and moved.
        for x in [[0.0; 4], [0.02, -0.01, 0.03, 0.015]] {
            let mut by_vertices = vec![DVec3::ZERO; vertices.len()];
            value(&x, &mut by_vertices);
            let gradient: Vec<f64> = (0..x.len())
                .map(|w| by_vertices.iter().enumerate().map(|(i, g)| g.dot(mode(w, i))).sum())
                .collect();
            let none = &mut vec![DVec3::ZERO; vertices.len()];
            assert_gradient(&x, &gradient, 2e-3, |x| value(x, none));
        }
    }

    /// Differences of the sums of eq. 10 over changes of some pixels, up to the neglected change of
    /// area.
    #[test]
    fn the_gradient_is_that_of_the_sums() {
        let (truth, faces) = body(1.0, 0.0);
        let energy = energy(&truth, &faces);
        let changes: [(&str, Change); 2] =
            [("shift", |t| body(1.0, 0.15 + t)), ("width", |t| body(1.1 + t, 0.0))];
        for (name, change) in changes {
            let step = 0.02;
            let [before, now, after] = [-step, 0.0, step].map(|t| change(t).0);
            let total = |v: &[DVec3]| sums(&energy, v, &faces).iter().sum::<f64>();
            let expected = (total(&after) - total(&before)) / (2.0 * step);
            let mut gradient = vec![DVec3::ZERO; now.len()];
            energy.match_surface(&now, &faces).unwrap().evaluate(&now, 1.0, &mut gradient);
            let moved = after.iter().zip(&before).map(|(a, b)| (*a - *b) / (2.0 * step));
            let found: f64 = gradient.iter().zip(moved).map(|(g, d)| g.dot(d)).sum();
            assert!((found - expected).abs() < 0.25 * expected.abs(), "{name}: {found} {expected}");
        }
    }

    #[test]
    fn soft_energies_have_the_gradient_of_differences() {
        let (truth, faces) = body(1.1, 0.03);
        let energy = energy(&truth, &faces).with_softness(1.5).unwrap();
        let at = |x: &[f64]| body(1.0 + x[0], x[1]).0;
        let matched = energy.match_surface(&at(&[0.0, 0.0]), &faces).unwrap();
        let value = |x: &[f64]| {
            let vertices = at(x);
            3.0 * matched.evaluate(&vertices, 3.0, &mut vec![DVec3::ZERO; vertices.len()]).total()
        };
        let x = [0.01, -0.01];
        let mut forces = vec![DVec3::ZERO; truth.len()];
        matched.evaluate(&at(&x), 3.0, &mut forces);
        let template = BODY.v_template.rows().into_iter();
        let wider: f64 = forces.iter().zip(template).map(|(f, v)| f.x * v[0] + f.z * v[2]).sum();
        let gradient = [wider, forces.iter().map(|f| f.x).sum::<f64>()];
        assert_gradient(&x, &gradient, 5e-3, value);
        assert!(gradient[1] < 0.0, "{gradient:?}");
        assert!(energy.with_softness(0.0).is_err());
    }

    #[test]
    fn bodies_outside_the_image_are_an_error() {
        let (truth, faces) = body(1.0, 0.0);
        let energy = energy(&truth, &faces);
        let (gone, _) = body(1.0, 50.0);
        assert!(
            energy.match_surface(&gone, &faces).unwrap_err().to_string().contains("left the image")
        );
        let empty = Mask::new(160, 160, vec![false; 160 * 160]).unwrap();
        assert!(SilhouetteEnergy::new(&camera(), &empty, None, 80, 0.01).is_err());
    }
}
