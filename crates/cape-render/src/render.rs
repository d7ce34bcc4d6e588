use cape_core::Mesh;
use glam::{Vec3, Vec4};
use rayon::prelude::*;

use crate::{
    Bounds, Camera, Error, Image, Material, Projection, Result, Texture, View,
    raster::{BAND, Bands, EMPTY, Point, barycentric},
    shade::{
        ContactShadow, Lights, ShadingPoint, sky_visibility, to_linear, to_srgb, vertex_normals,
    },
};

/// Largest number of samples per pixel.
const MAX_SAMPLES: usize = 64;

/// Interpolation of the normals over a face.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Shading {
    /// Interpolated vertex normals.
    #[default]
    Smooth,
    /// Face normals, which show the triangles.
    Flat,
}

/// Mesh in a scene, with its material, vertex colours or texture.
///
/// ```
/// use cape_synth::synthetic_body;
/// use cape_render::{Material, Object, Style, View, portrait};
///
/// let body = synthetic_body().mesh();
/// let style = Style { width: 32, height: 32, ..Style::default() };
/// let red = Material { colour: [0.8, 0.1, 0.1], gloss: 0.0 };
/// let faceted = Object { material: red, ..Object::new(&body).with_flat_shading() };
/// let [r, g, ..] = portrait(faceted, View::Front, &style)?.get(16, 16).unwrap();
/// assert!(r > g);
///
/// let green = vec![[0.1, 0.8, 0.1]; body.vertices.len()];
/// let painted = Object::new(&body).with_colours(&green);
/// let [r, g, ..] = portrait(painted, View::Front, &style)?.get(16, 16).unwrap();
/// assert!(g > r);
/// # Ok::<(), cape_render::Error>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Object<'a> {
    /// Mesh.
    pub mesh: &'a Mesh,
    /// sRGB vertex colours, 0 to 1, `[vertices, 3]`.
    pub colours: Option<&'a [[f32; 3]]>,
    /// Reflectance.
    pub material: Material,
    /// Texture, which replaces colours.
    pub texture: Option<Texture<'a>>,
    /// Interpolation of the normals.
    pub shading: Shading,
}

impl<'a> Object<'a> {
    /// Object of the default material and smooth shading.
    pub fn new(mesh: &'a Mesh) -> Self {
        Self {
            mesh,
            colours: None,
            material: Material::default(),
            texture: None,
            shading: Shading::Smooth,
        }
    }

    /// Sets sRGB vertex colours, 0 to 1, `[vertices, 3]`.
    #[must_use]
    pub fn with_colours(self, colours: &'a [[f32; 3]]) -> Self {
        Self { colours: Some(colours), ..self }
    }

    /// Sets the texture.
    #[must_use]
    pub fn with_texture(self, texture: Texture<'a>) -> Self {
        Self { texture: Some(texture), ..self }
    }

    /// Sets flat shading.
    #[must_use]
    pub fn with_flat_shading(self) -> Self {
        Self { shading: Shading::Flat, ..self }
    }
}

/// Background of an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Background {
    /// Vertical gradient of sRGB colours, top and bottom, 0 to 1.
    Gradient([f32; 3], [f32; 3]),
    /// Transparent: alpha is the coverage by the scene.
    Transparent,
}

/// Image size, sampling, background and shadows of a rendering.
///
/// ```
/// use cape_synth::synthetic_body;
/// use cape_render::{Background, Object, Style, View, portrait};
///
/// let body = synthetic_body().mesh();
/// let cut_out = Style {
///     width: 32,
///     height: 32,
///     background: Background::Transparent,
///     floor: false,
///     ..Style::default()
/// };
/// let image = portrait(Object::new(&body), View::Front, &cut_out)?;
/// let alpha = |x, y| image.get(x, y).unwrap()[3];
/// assert_eq!((alpha(16, 16), alpha(0, 0)), (255, 0));
/// # Ok::<(), cape_render::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Style {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Samples per pixel along each axis, 1 to 8.
    pub samples: u32,
    /// Background of the image.
    pub background: Background,
    /// Draw a contact shadow on a floor at the lowest point of the scene.
    pub floor: bool,
    /// Draw shadows of the key light and ambient occlusion.
    pub shadows: bool,
}

impl Default for Style {
    fn default() -> Self {
        Self {
            width: 512,
            height: 512,
            samples: 3,
            background: Background::Gradient([0.93, 0.94, 0.955], [0.78, 0.79, 0.81]),
            floor: true,
            shadows: true,
        }
    }
}

/// Appearance of the faces of an object.
struct Appearance<'a> {
    first_face: u32,
    gloss: f32,
    texture: Option<Texture<'a>>,
    shading: Shading,
}

/// All objects in one vertex and one face array.
struct Scene<'a> {
    vertices: Vec<Vec3>,
    normals: Vec<Vec3>,
    colours: Vec<Vec3>,
    /// Ambient visibility of the vertices, if shadows are drawn.
    sky: Option<Vec<f32>>,
    faces: Vec<[u32; 3]>,
    /// Appearance of each object, in the order of the faces.
    appearances: Vec<Appearance<'a>>,
    bounds: Bounds,
}

impl<'a> Scene<'a> {
    fn new(objects: &[Object<'a>]) -> Result<Self> {
        let bounds =
            Bounds::from_meshes(objects.iter().map(|object| object.mesh)).ok_or_else(|| {
                Error::Argument("nothing to draw: the meshes have no vertices".into())
            })?;
        let mut scene = Self {
            vertices: Vec::new(),
            normals: Vec::new(),
            colours: Vec::new(),
            sky: None,
            faces: Vec::new(),
            appearances: Vec::new(),
            bounds,
        };
        for (index, object) in objects.iter().enumerate() {
            scene.add(index, object)?;
        }
        Ok(scene)
    }

    fn add(&mut self, index: usize, object: &Object<'a>) -> Result<()> {
        let &Object { mesh, colours, material, texture, shading } = object;
        let count = mesh.vertices.len();
        if let Some(v) = mesh.vertices.iter().position(|v| !v.iter().all(|x| x.is_finite())) {
            return Err(Error::Argument(format!("object {index}: vertex {v} is not finite")));
        }
        if let Some(f) = mesh.faces.iter().position(|f| f.iter().any(|&i| i as usize >= count)) {
            return Err(Error::Argument(format!(
                "object {index}: face {f} has a vertex index out of range for {count} vertices"
            )));
        }
        match colours {
            Some(colours) if colours.len() != count => {
                return Err(Error::Argument(format!(
                    "object {index}: {} colours for {count} vertices",
                    colours.len()
                )));
            }
            Some(colours) => self.colours.extend(colours.iter().map(|&c| to_linear(c))),
            None => self.colours.extend(std::iter::repeat_n(to_linear(material.colour), count)),
        }
        if let Some(texture) = texture {
            texture.check(index, mesh.faces.len())?;
        }
        let offset = self.vertices.len() as u32;
        let first_face = self.faces.len() as u32;
        self.appearances.push(Appearance { first_face, gloss: material.gloss, texture, shading });
        self.vertices.extend(mesh.vertices.iter().map(|&v| Vec3::from(v)));
        self.faces.extend(mesh.faces.iter().map(|face| face.map(|i| i + offset)));
        self.normals.extend(vertex_normals(mesh));
        Ok(())
    }

    fn appearance(&self, face: u32) -> &Appearance<'a> {
        let after = self.appearances.partition_point(|object| object.first_face <= face);
        &self.appearances[after - 1]
    }

    fn surface(&self, camera: &Camera, face: u32, weights: [f32; 3]) -> ShadingPoint {
        let corners = self.faces[face as usize].map(|i| i as usize);
        let blend = |of: &[Vec3]| {
            of[corners[0]] * weights[0] + of[corners[1]] * weights[1] + of[corners[2]] * weights[2]
        };
        let position = blend(&self.vertices);
        let eye = camera.towards(position);
        let appearance = self.appearance(face);
        let [a, b, c] = corners.map(|i| self.vertices[i]);
        let flat = (b - a).cross(c - a);
        let flipped = flat.dot(eye) < 0.0;
        let normal = match appearance.shading {
            Shading::Smooth => blend(&self.normals).normalize_or(eye),
            Shading::Flat => flat.normalize_or(eye),
        };
        ShadingPoint {
            position,
            normal: if flipped { -normal } else { normal },
            eye,
            albedo: match &appearance.texture {
                Some(texture) => texture.at((face - appearance.first_face) as usize, weights),
                None => blend(&self.colours),
            },
            sky: self
                .sky
                .as_ref()
                .map_or(1.0, |sky| (0..3).map(|i| sky[corners[i]] * weights[i]).sum()),
            gloss: appearance.gloss,
        }
    }
}

/// Renders `objects` as seen by `camera`.
///
/// Triangles that reach behind the camera are omitted. The image does not depend on the number of
/// threads.
///
/// # Errors
/// If the meshes have no vertices, an object is inconsistent, or the size or number of samples is out of
/// range.
pub fn render(objects: &[Object<'_>], camera: &Camera, style: &Style) -> Result<Image> {
    if !(1..=8).contains(&style.samples) {
        return Err(Error::Argument(format!(
            "{} samples per pixel along each axis: expected 1 to 8",
            style.samples
        )));
    }
    let mut image = Image::new(style.width, style.height, [0; 4])?;
    let mut scene = Scene::new(objects)?;
    let (sky, (lights, floor)) = rayon::join(
        || {
            let Scene { vertices, normals, faces, bounds, .. } = &scene;
            style.shadows.then(|| sky_visibility(vertices, normals, faces, bounds))
        },
        || {
            rayon::join(
                || Lights::new(camera, &scene.vertices, &scene.faces, &scene.bounds, style.shadows),
                || {
                    let floor = || ContactShadow::new(&scene.vertices, &scene.faces, &scene.bounds);
                    style.floor.then(floor)
                },
            )
        },
    );
    scene.sky = sky;

    let samples = style.samples as usize;
    let (width, height) = (style.width as usize * samples, style.height as usize * samples);
    let points: Vec<Point> = scene
        .vertices
        .iter()
        .map(|&v| Point::project((camera.clip * v.extend(1.0)).to_array(), width, height))
        .collect();
    let rows = BAND.next_multiple_of(samples);
    let bands = Bands::new(&points, &scene.faces, [width, height], rows);
    let backdrop = Backdrop::new(camera, style, floor);
    let size = style.width as usize * (rows / samples);
    image.pixels_mut().par_chunks_mut(size).enumerate().for_each_init(
        || (vec![EMPTY; width * rows], vec![f32::INFINITY; width * rows]),
        |(face, depth), (band, pixels)| {
            let visible = (!bands.is_empty(band)).then(|| {
                face.fill(EMPTY);
                depth.fill(f32::INFINITY);
                bands.draw(band, face, depth);
                &*face
            });
            let top = band * (rows / samples);
            for (row, line) in pixels.chunks_exact_mut(style.width as usize).enumerate() {
                for (column, pixel) in line.iter_mut().enumerate() {
                    let (light, covered) = visible.map_or((Vec3::ZERO, 0.0), |visible| {
                        let samples = Samples { visible, top: band * rows, width, side: samples };
                        samples.gather(&scene, camera, &lights, &points, column, top + row)
                    });
                    *pixel = backdrop.compose(light, covered, column, top + row);
                }
            }
        },
    );
    Ok(image)
}

/// Renders one object, framed from a standard view.
///
/// # Errors
/// See [`render`].
pub fn portrait(object: Object<'_>, view: View, style: &Style) -> Result<Image> {
    let bounds = Bounds::from_meshes([object.mesh])
        .ok_or_else(|| Error::Argument("nothing to draw: the mesh has no vertices".into()))?;
    let aspect = style.width as f32 / style.height.max(1) as f32;
    let camera = Camera::framing(&bounds, view, Projection::default(), aspect);
    render(&[object], &camera, style)
}

/// Visible faces of the samples of a band of rows.
struct Samples<'a> {
    visible: &'a [u32],
    /// First row of samples of the band.
    top: usize,
    /// Samples in a row.
    width: usize,
    /// Samples per pixel along each axis.
    side: usize,
}

impl Samples<'_> {
    /// Radiance of a pixel, summed over covered samples, and its coverage, 0 to 1.
    fn gather(
        &self,
        scene: &Scene<'_>,
        camera: &Camera,
        lights: &Lights,
        points: &[Point],
        column: usize,
        row: usize,
    ) -> (Vec3, f32) {
        let side = self.side;
        // A face is shaded once per pixel, at the first of its samples.
        let mut faces = [(EMPTY, 0, [0; 2]); MAX_SAMPLES];
        let (mut distinct, mut count) = (0, 0);
        for y in row * side..(row + 1) * side {
            let start = (y - self.top) * self.width + column * side;
            for (x, &face) in self.visible[start..start + side].iter().enumerate() {
                if face == EMPTY {
                    continue;
                }
                count += 1;
                let known = faces[..distinct].iter_mut().find(|(known, ..)| *known == face);
                if let Some((_, times, _)) = known {
                    *times += 1;
                } else {
                    faces[distinct] = (face, 1, [column * side + x, y]);
                    distinct += 1;
                }
            }
        }
        let light: Vec3 = faces[..distinct]
            .iter()
            .map(|&(face, times, [x, y])| {
                let corners = scene.faces[face as usize].map(|i| &points[i as usize]);
                let surface = scene.surface(camera, face, barycentric(corners, x, y));
                tone(lights.shade(&surface)) * times as f32
            })
            .sum();
        let scale = 1.0 / (side * side) as f32;
        (light * scale, count as f32 * scale)
    }
}

/// Tone mapping that compresses highlights towards 1.
fn tone(light: Vec3) -> Vec3 {
    const KNEE: f32 = 0.7;
    let roll = |l: f32| {
        if l <= KNEE {
            l
        } else {
            let over = (l - KNEE) / (1.0 - KNEE);
            KNEE + (1.0 - KNEE) * over / (1.0 + over)
        }
    };
    Vec3::new(roll(light.x), roll(light.y), roll(light.z))
}

/// Background and floor behind the scene.
struct Backdrop {
    ends: Option<[Vec3; 2]>,
    floor: Option<ContactShadow>,
    inverse: glam::Mat4,
    size: [f32; 2],
}

impl Backdrop {
    fn new(camera: &Camera, style: &Style, floor: Option<ContactShadow>) -> Self {
        let ends = match style.background {
            Background::Gradient(top, bottom) => Some([to_linear(top), to_linear(bottom)]),
            Background::Transparent => None,
        };
        Self {
            ends,
            floor,
            inverse: camera.clip.inverse(),
            size: [style.width as f32, style.height as f32],
        }
    }

    fn compose(&self, light: Vec3, covered: f32, column: usize, row: usize) -> [u8; 4] {
        let (x, y) = ((column as f32 + 0.5) / self.size[0], (row as f32 + 0.5) / self.size[1]);
        let shadow = if covered < 1.0 { self.shadow(x, y) } else { 0.0 };
        if let Some([top, bottom]) = self.ends {
            let away = Vec4::new(x - 0.5, y - 0.45, 0.0, 0.0).length_squared();
            let behind = top.lerp(bottom, y * y * (3.0 - 2.0 * y)) * (1.0 - 0.25 * away);
            let [r, g, b] = to_srgb(light + behind * ((1.0 - covered) * (1.0 - shadow)));
            return [r, g, b, 255];
        }
        // Straight alpha: the shadow is black.
        let alpha = covered + (1.0 - covered) * shadow;
        if alpha <= 0.0 {
            return [0; 4];
        }
        let [r, g, b] = to_srgb(light / alpha);
        [r, g, b, (alpha * 255.0).round() as u8]
    }

    fn shadow(&self, x: f32, y: f32) -> f32 {
        let Some(floor) = &self.floor else { return 0.0 };
        let (origin, direction) = Camera::ray(&self.inverse, 2.0 * x - 1.0, 1.0 - 2.0 * y);
        let distance = (floor.y - origin.y) / direction.y;
        if direction.y >= -1e-4 || distance < 0.0 {
            return 0.0;
        }
        let hit = origin + direction * distance;
        floor.at(hit.x, hit.z)
    }
}
