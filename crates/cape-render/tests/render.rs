//! Rendered images: visibility, independence of the number of threads, and a small snapshot.

use cape_core::{Mesh, obj::Uv};
use cape_render::{
    Background, Bounds, Camera, Image, Object, Projection, Style, Texture, View, portrait, render,
    silhouette,
};
use glam::Vec3;
use std::f32::consts::TAU;

/// A torus around the y axis.
fn torus(rings: u32, sides: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for i in 0..rings {
        for j in 0..sides {
            let (u, v) = (TAU * i as f32 / rings as f32, TAU * j as f32 / sides as f32);
            let radius = 1.0 + 0.4 * v.cos();
            mesh.vertices.push([radius * u.sin(), 0.4 * v.sin(), radius * u.cos()]);
            let at = |a: u32, b: u32| (a % rings) * sides + b % sides;
            let [p, q, r, s] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            mesh.faces.extend([[p, q, r], [p, r, s]]);
        }
    }
    mesh
}

/// A square facing +z at depth `z`.
fn square(z: f32, half: f32) -> Mesh {
    Mesh {
        vertices: vec![[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]],
        faces: vec![[0, 1, 2], [0, 2, 3]],
    }
}

fn plain(side: u32) -> Style {
    Style {
        width: side,
        height: side,
        samples: 1,
        background: Background::Transparent,
        floor: false,
        shadows: false,
    }
}

fn camera(objects: &[&Mesh], view: View) -> Camera {
    let bounds = Bounds::from_meshes(objects.iter().copied()).unwrap();
    Camera::framing(&bounds, view, Projection::default(), 1.0)
}

#[test]
fn the_nearer_object_hides_the_farther_one_in_any_order() {
    let (near, far) = (square(0.5, 0.3), square(-0.5, 0.8));
    let (red, blue) = ([[1.0, 0.0, 0.0]; 4], [[0.0, 0.0, 1.0]; 4]);
    let objects = [Object::new(&near).with_colours(&red), Object::new(&far).with_colours(&blue)];
    let camera = camera(&[&near, &far], View::Front);
    let first = render(&objects, &camera, &plain(64)).unwrap();
    let second = render(&[objects[1], objects[0]], &camera, &plain(64)).unwrap();
    assert_eq!(first, second);
    let [r, _, b, _] = first.get(32, 32).unwrap();
    assert!(r > 2 * b, "the near square is in the middle");
    let [r, _, b, _] = first.get(12, 32).unwrap();
    assert!(b > 2 * r, "the far square shows around it");
}

#[test]
fn the_picture_does_not_depend_on_the_number_of_threads() {
    let mesh = torus(60, 30);
    let style = Style { width: 96, height: 80, samples: 2, ..Style::default() };
    let draw = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| portrait(Object::new(&mesh), View::ThreeQuarter, &style).unwrap())
    };
    let one = draw(1);
    assert_eq!(one, draw(2));
    assert_eq!(one, draw(5));
}

#[test]
fn coverage_of_a_disc_is_its_area() {
    let n = 720;
    let mut mesh = Mesh { vertices: vec![[0.0; 3]], faces: Vec::new() };
    for i in 0..n {
        let angle = TAU * i as f32 / n as f32;
        mesh.vertices.push([angle.cos(), angle.sin(), 0.0]);
        mesh.faces.push([0, 1 + i, 1 + (i + 1) % n]);
    }
    let eye = Vec3::new(0.0, 0.0, 5.0);
    let camera = Camera::look_at(eye, Vec3::ZERO, Projection::Orthographic, 1.0, [1.0, 9.0]);
    let image =
        render(&[Object::new(&mesh)], &camera, &Style { samples: 4, ..plain(128) }).unwrap();
    let alpha: f64 = image.pixels().iter().map(|p| f64::from(p[3]) / 255.0).sum();
    let scale = 64.0 / (5.0 * 0.25_f64.tan());
    let area = std::f64::consts::PI * scale * scale;
    assert!((alpha / area - 1.0).abs() < 2e-3, "{alpha} of {area}");
}

#[test]
fn shadows_only_darken_and_reach_the_floor() {
    let mesh = torus(60, 30);
    let style = Style { width: 64, height: 64, samples: 1, ..Style::default() };
    let sum = |style: &Style| -> u64 {
        let image = portrait(Object::new(&mesh), View::Front, style).unwrap();
        image.pixels().iter().map(|p| u64::from(p[0])).sum()
    };
    let bare = sum(&Style { floor: false, shadows: false, ..style });
    let shaded = sum(&Style { floor: false, ..style });
    let grounded = sum(&style);
    assert!(bare > shaded + 200 && shaded > grounded + 1000, "{bare} {shaded} {grounded}");
}

/// Mean red of each cell of an 8×8 grid.
fn thumbnail(image: &Image) -> [[i32; 8]; 8] {
    let cell = image.width() / 8;
    std::array::from_fn(|row| {
        std::array::from_fn(|column| {
            let mut sum = 0;
            for y in 0..cell {
                for x in 0..cell {
                    let pixel = image.get(column as u32 * cell + x, row as u32 * cell + y);
                    sum += i32::from(pixel.unwrap()[0]);
                }
            }
            sum / (cell * cell) as i32
        })
    })
}

#[test]
fn a_torus_looks_as_it_did() {
    let style = Style { width: 64, height: 64, samples: 2, ..Style::default() };
    let image = portrait(Object::new(&torus(80, 40)), View::ThreeQuarter, &style).unwrap();
    let seen = thumbnail(&image);
    let expected = [
        [227, 229, 231, 232, 232, 231, 229, 227],
        [226, 229, 231, 231, 231, 231, 229, 226],
        [223, 225, 227, 228, 228, 227, 225, 223],
        [217, 221, 226, 224, 221, 211, 206, 217],
        [210, 191, 164, 161, 150, 133, 172, 210],
        [202, 204, 202, 196, 196, 202, 204, 202],
        [195, 197, 199, 199, 199, 199, 197, 195],
        [189, 191, 193, 194, 194, 193, 191, 189],
    ];
    for (seen, expected) in seen.iter().flatten().zip(expected.iter().flatten()) {
        assert!((seen - expected).abs() <= 3, "{:?}", thumbnail(&image));
    }
}

#[test]
fn unusable_scenes_are_errors() {
    let style = plain(16);
    let mesh = square(0.0, 1.0);
    let camera = camera(&[&mesh], View::Front);
    let message = |mesh: &Mesh, colours: Option<&[[f32; 3]]>, style: &Style| {
        let object = Object { colours, ..Object::new(mesh) };
        render(&[object], &camera, style).unwrap_err().to_string()
    };
    assert!(message(&Mesh::default(), None, &style).contains("no vertices"));
    let faces = vec![[0, 1, 4]];
    assert!(message(&Mesh { faces, ..mesh.clone() }, None, &style).contains("face 0"));
    let mut broken = mesh.clone();
    broken.vertices[2][1] = f32::NAN;
    assert!(message(&broken, None, &style).contains("vertex 2"));
    assert!(message(&mesh, Some(&[[0.0; 3]; 3]), &style).contains("3 colours for 4"));
    assert!(message(&mesh, None, &Style { samples: 0, ..style }).contains("samples"));
    assert!(message(&mesh, None, &Style { width: 0, ..style }).contains("pixels"));
}

#[test]
fn flat_shading_is_the_same_all_over_a_face() {
    let mesh = torus(9, 7);
    let camera = camera(&[&mesh], View::Front);
    let colours = |object: Object| {
        let image = render(&[object], &camera, &plain(128)).unwrap();
        let pixels: std::collections::BTreeSet<_> =
            image.pixels().iter().filter(|pixel| pixel[3] == 255).copied().collect();
        pixels.len()
    };
    // The highlight follows the eye, so that a face's pixels differ a little.
    let (smooth, flat) =
        (colours(Object::new(&mesh)), colours(Object::new(&mesh).with_flat_shading()));
    assert!(3 * flat < smooth, "{flat} colours flat, {smooth} smooth");
}

#[test]
fn a_texture_lies_on_the_surface_the_right_way_up() {
    let mesh = square(0.0, 1.0);
    let uv = Uv {
        coordinates: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
        faces: mesh.faces.clone(),
    };
    let mut image = Image::new(2, 2, [255, 255, 255, 255]).unwrap();
    // Top left red, top right green, bottom left blue.
    image.pixels_mut()[..3].copy_from_slice(&[
        [255, 0, 0, 255],
        [0, 255, 0, 255],
        [0, 0, 255, 255],
    ]);
    let texture = Texture { uv: &uv, image: &image };
    let camera = Camera::look_at(
        Vec3::new(0.0, 0.0, 5.0),
        Vec3::ZERO,
        Projection::Orthographic,
        1.0,
        [1.0, 9.0],
    );
    let picture = render(&[Object::new(&mesh).with_texture(texture)], &camera, &plain(64)).unwrap();
    let strongest = |x: u32, y: u32| {
        let [r, g, b, _] = picture.get(x, y).unwrap();
        [r, g, b].map(|c| c > 128)
    };
    assert_eq!(strongest(18, 18), [true, false, false]);
    assert_eq!(strongest(45, 18), [false, true, false]);
    assert_eq!(strongest(18, 45), [false, false, true]);
    assert_eq!(strongest(45, 45), [true, true, true]);

    let short = Uv { faces: uv.faces[..1].to_vec(), ..uv.clone() };
    let wrong = Texture { uv: &short, image: &image };
    assert!(render(&[Object::new(&mesh).with_texture(wrong)], &camera, &plain(8)).is_err());
}

#[test]
fn a_silhouette_is_what_is_drawn() {
    let mesh = torus(40, 30);
    let camera = camera(&[&mesh], View::ThreeQuarter);
    let mask = silhouette(&mesh, &camera, 96, 96).unwrap();
    let picture = render(&[Object::new(&mesh)], &camera, &plain(96)).unwrap();
    let pairs = mask.pixels().iter().zip(picture.pixels());
    assert!(pairs.into_iter().all(|(mask, drawn)| (mask[0] == 255) == (drawn[3] == 255)));
    let broken = Mesh { faces: vec![[0, 1, 9999]], ..mesh };
    assert!(silhouette(&broken, &camera, 96, 96).is_err());
}
