//! Valid files of the kinds that need more than a writer's call.

use std::{fs, io::Write, path::Path};

use cape::{
    core::{
        BodyMotion, SmplModel,
        gltf::{self, Keyframe, SkinnedMesh},
        motion::SmplFile,
    },
    render::Image,
};
use ndarray::{Array2, Array3, arr2};
use safetensors::{SafeTensors, tensor::TensorView};

/// A skinned triangle of two joints with `keyframes` keyframes.
pub(crate) fn write_glb(path: &Path, keyframes: usize) {
    let body = SmplModel {
        v_template: arr2(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [0.0, 1.0, 0.0]]),
        shapedirs: Array3::zeros((3, 3, 1)),
        posedirs: Array3::zeros((3, 3, 9)),
        joint_regressor: arr2(&[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        weights: arr2(&[[1.0, 0.0], [0.0, 1.0], [0.5, 0.5]]),
        parents: vec![None, Some(0)],
        faces: vec![[0, 1, 2]],
    };
    let skinned = SkinnedMesh {
        name: "a",
        body: &body,
        rest: body.v_template.clone(),
        joints: body.rest_joints(&body.v_template).unwrap(),
        colours: None,
        texture: None,
        targets: Vec::new(),
    };
    let keyframe = |step: usize| Keyframe {
        time: step as f32,
        pose: vec![0.1 * step as f64; 6],
        transl: [0.0; 3],
        offset: Some(Array2::from_elem((3, 3), 0.1)),
    };
    let keyframes: Vec<Keyframe> = (0..keyframes).map(keyframe).collect();
    gltf::write(path, &skinned, &keyframes).unwrap();
}

/// Two frames of a motion as `.smpl`, MATLAB's file, JSON and CSV.
pub(crate) fn write_motions(directory: &Path) {
    let motion =
        BodyMotion::new(30.0, Array2::from_elem((2, 72), 0.1), Array2::ones((2, 3))).unwrap();
    let file = SmplFile { motion: &motion, betas: &[0.5], gender: Some("female"), offsets: None };
    file.save(directory.join("1.smpl")).unwrap();
    let mut mat = b"MATLAB 5.0 MAT-file, Platform: posix".to_vec();
    mat.resize(124, b' ');
    mat.extend([0, 1, b'I', b'M']);
    for (name, rows, compressed) in [("poses", 72, true), ("trans", 3, false), ("shape", 10, false)]
    {
        let matrix = matrix(name, rows);
        if compressed {
            let mut writer =
                flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
            writer.write_all(&matrix).unwrap();
            let data = writer.finish().unwrap();
            mat.extend([15u32.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat());
            mat.extend(data);
        } else {
            mat.extend(matrix);
        }
    }
    fs::write(directory.join("1.mat"), mat).unwrap();
    let row = vec!["0.1"; 72].join(",");
    fs::write(directory.join("1.csv"), format!("{row}\n{row}\n")).unwrap();
    fs::write(directory.join("1.json"), format!(r#"{{"poses":[[{row}],[{row}]],"fps":30}}"#))
        .unwrap();
}

/// A matrix of `rows` × 2 float64 of MATLAB's level 5.
fn matrix(name: &str, rows: usize) -> Vec<u8> {
    let element = |kind: u32, data: &[u8]| {
        let mut bytes = [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
        bytes.extend(data);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    };
    let shape = [(rows as i32).to_le_bytes(), 2i32.to_le_bytes()].concat();
    let numbers: Vec<u8> = (0..2 * rows).flat_map(|k| (0.01 * k as f64).to_le_bytes()).collect();
    let parts = [
        element(6, &[6, 0, 0, 0, 0, 0, 0, 0]),
        element(5, &shape),
        element(1, name.as_bytes()),
        element(9, &numbers),
    ];
    element(14, &parts.concat())
}

/// Keypoints and outlines of one person in the JSON of OpenPose and of COCO.
pub(crate) fn write_annotations(directory: &Path) {
    let points = |n: usize| vec!["10,20.5,0.9"; n].join(",");
    let openpose = format!(r#"{{"people":[{{"pose_keypoints_2d":[{}]}}]}}"#, points(25));
    fs::write(directory.join("2.json"), openpose).unwrap();
    let coco = format!(
        r#"{{"images":[{{"id":1,"width":64,"height":48,"file_name":"a.png"}}],"annotations":[{{"image_id":1,
        "keypoints":[{}],"segmentation":[[0,0,30,0,30,40.5,0,40]]}}]}}"#,
        points(17)
    );
    fs::write(directory.join("3.json"), coco).unwrap();
    let runs = r#"{"size":[48,64],"counts":[100,200,2772]}"#;
    fs::write(directory.join("4.json"), runs).unwrap();
    let packed = r#"{"size":[48,64],"counts":"l0P1oN`0"}"#;
    fs::write(directory.join("5.json"), packed).unwrap();
}

/// A mask as PNG and JPEG.
pub(crate) fn write_images(directory: &Path) {
    let mut image = Image::new(16, 12, [0, 0, 0, 255]).unwrap();
    image.pixels_mut()[40..90].fill([255; 4]);
    image.save(directory.join("1.png")).unwrap();
    let grey: Vec<u8> = image.pixels().iter().map(|pixel| pixel[0]).collect();
    let encoder = jpeg_encoder::Encoder::new_file(directory.join("1.jpg"), 90).unwrap();
    encoder.encode(&grey, 16, 12, jpeg_encoder::ColorType::Luma).unwrap();
}

/// The built-in model without its weights, which are read like those of checkpoints.
pub(crate) fn write_model(path: &Path) {
    let bytes = fs::read("crates/cape-weights/data/model.safetensors").unwrap();
    let (_, metadata) = SafeTensors::read_metadata(&bytes).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let tensors = file.tensors();
    let kept = tensors.iter().filter(|(name, _)| !name.starts_with("generator."));
    let views: Vec<(String, TensorView<'_>)> = kept.cloned().collect();
    assert!(views.len() > 3 && views.len() < tensors.len());
    let bytes = safetensors::serialize(views, metadata.metadata().clone()).unwrap();
    fs::write(path, bytes).unwrap();
}
