//! MATLAB's files, as SURREAL and CLOTH3D have them.

use std::io::Write;

use super::*;

/// Writer of MATLAB's files of level 5.
struct Mat(Vec<u8>);

impl Mat {
    fn new() -> Self {
        let mut header = b"MATLAB 5.0 MAT-file, Platform: posix".to_vec();
        header.resize(124, b' ');
        header.extend([0, 1, b'I', b'M']);
        Self(header)
    }

    fn element(kind: u32, data: &[u8]) -> Vec<u8> {
        let mut bytes = if (1..=4).contains(&data.len()) {
            (kind | (data.len() as u32) << 16).to_le_bytes().to_vec()
        } else {
            [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat()
        };
        bytes.extend(data);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    }

    fn matrix(class: u8, name: &str, shape: [usize; 2], content: &[u8]) -> Vec<u8> {
        let flags = Self::element(6, &[class, 0, 0, 0, 0, 0, 0, 0]);
        let sizes: Vec<u8> = shape.iter().flat_map(|&n| (n as i32).to_le_bytes()).collect();
        let inner = [flags, Self::element(5, &sizes), Self::element(1, name.as_bytes())].concat();
        Self::element(14, &[inner, content.to_vec()].concat())
    }

    /// Adds an array as it is seen from MATLAB, compressed as `scipy.io.savemat` does by option.
    fn numbers(mut self, name: &str, array: &Array2<f64>, compressed: bool) -> Self {
        let numbers: Vec<u8> = array.t().iter().flat_map(|x| x.to_le_bytes()).collect();
        let shape = [array.nrows(), array.ncols()];
        let matrix = Self::matrix(6, name, shape, &Self::element(9, &numbers));
        if compressed {
            let mut writer =
                flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
            writer.write_all(&matrix).unwrap();
            let data = writer.finish().unwrap();
            self.0.extend([15u32.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat());
            self.0.extend(data);
        } else {
            self.0.extend(matrix);
        }
        self
    }

    /// Adds a number that is stored as a byte.
    fn byte(mut self, name: &str, value: u8) -> Self {
        self.0.extend(Self::matrix(9, name, [1, 1], &Self::element(2, &[value])));
        self
    }

    /// Adds a structure without fields.
    fn structure(mut self, name: &str) -> Self {
        let fields = [Self::element(5, &32i32.to_le_bytes()), Self::element(1, &[])].concat();
        self.0.extend(Self::matrix(2, name, [1, 1], &fields));
        self
    }
}

fn ways() -> Array2<f64> {
    Array2::from_shape_fn((FRAMES, 3), |(frame, axis)| 0.1 * (frame * 3 + axis) as f64)
}

fn shape() -> Array2<f64> {
    Array2::from_shape_fn((10, 1), |(k, _)| 0.1 * k as f64)
}

#[test]
fn cloth3d_moves_the_pelvis() {
    let files = Files::new();
    // Frames in columns; z is up, as the body stands.
    let upright = turned(DQuat::from_rotation_x(PI / 2.0));
    for compressed in [false, true] {
        let mat = Mat::new()
            .structure("outfit")
            .numbers("poses", &upright.t().to_owned(), compressed)
            .numbers("trans", &ways().t().to_owned(), compressed)
            .numbers("shape", &shape().t().to_owned(), compressed)
            .byte("gender", 1)
            .numbers("zrot", &Array2::from_elem((1, 1), 0.3), compressed);
        let file = read(&files.bytes("info.mat", &mat.0));
        expect_poses(&file.poses, &upright);
        assert_eq!(file.translations, Some(ways()));
        assert_eq!((file.betas.len(), file.betas[3]), (10, 0.1 * 3.0));
        assert_eq!((file.gender.as_deref(), file.up), (Some("male"), UpAxis::Z));
        assert_eq!(file.pivot, Pivot::PelvisAtOrigin);
        // The pelvis of any body comes to the translation, turned upright.
        let pelvis = [0.01, -0.2, 0.03];
        let motion = file.motion(None, pelvis).unwrap();
        for (frame, place) in ways().rows().into_iter().enumerate() {
            let at = [0, 1, 2].map(|axis| pelvis[axis] + motion.translations[(frame, axis)]);
            let upright = [place[0], place[2], -place[1]];
            assert!(at.iter().zip(upright).all(|(a, b)| (a - b).abs() < 1e-12), "{at:?}");
        }
    }
}

#[test]
fn surreal_has_shapes_of_all_frames() {
    let files = Files::new();
    let shapes = shape().broadcast((10, FRAMES)).unwrap().to_owned();
    let genders = Array2::zeros((FRAMES, 1));
    let mat = Mat::new()
        .numbers("pose", &poses().t().to_owned(), true)
        .numbers("shape", &shapes, true)
        .numbers("gender", &genders, true);
    let file = read(&files.bytes("01_01_c0001_info.mat", &mat.0));
    expect_poses(&file.poses, &poses());
    assert!((file.betas[9] - 0.9).abs() < 1e-12);
    assert_eq!((file.gender.as_deref(), file.pivot), (Some("female"), Pivot::Pelvis));
    // Rows as Python's users save them.
    let mat = Mat::new().numbers("poses", &poses(), false);
    expect_poses(&read(&files.bytes("rows.mat", &mat.0)).poses, &poses());
}

#[test]
fn broken_matlab_files_are_refused() {
    let files = Files::new();
    let whole = Mat::new().numbers("poses", &poses().t().to_owned(), true).structure("outfit").0;
    for length in [40, 127, 130, 150, whole.len() - 70] {
        let message = error(&files.bytes("cut.mat", &whole[..length]));
        assert!(message.contains("MATLAB file: "), "{length}: {message}");
    }
    let mut big = whole.clone();
    big[126..128].copy_from_slice(b"MI");
    assert!(error(&files.bytes("big.mat", &big)).contains("big-endian"));
    // No change of a byte makes it panic.
    for at in 128..whole.len() {
        for value in [0, 1, 0x7f, 0xff] {
            let mut changed = whole.clone();
            changed[at] = value;
            let path = files.bytes("changed.mat", &changed);
            let _ = read_motion(&path, &MotionOptions::default());
        }
    }
    let without = Mat::new().structure("outfit").numbers("trans", &ways(), false).0;
    let message = error(&files.bytes("without.mat", &without));
    assert!(message.contains("trans [6, 3]") && message.contains("a structure"), "{message}");
}
