//! People in the JSON of detectors.

use serde_json::{Map, Value};

/// Names of the points of a person, in order of preference.
const POINTS: [&str; 5] =
    ["pose_keypoints_2d", "pose_keypoints", "keypoints", "joints", "landmarks"];
/// Names of the confidences apart from the points.
const SCORES: [&str; 2] = ["keypoint_scores", "scores"];
/// Names of a confidence within a point.
const CONFIDENCE: [&str; 5] = ["score", "confidence", "visibility", "visible", "c"];
/// Names of lists of people of one image.
const PEOPLE: [&str; 5] = ["people", "bodies", "instances", "preds", "predictions"];
/// Names of landmarks of one person or of several.
const LANDMARKS: [&str; 4] = ["pose_landmarks", "poseLandmarks", "landmarks", "landmark"];
/// Names of what tells an image from others.
const IMAGES: [&str; 5] = ["image_id", "file_name", "image_path", "frame_id", "image"];

/// Person of a file.
#[derive(Debug, Clone)]
pub(super) struct Entry {
    /// Place in the file.
    pub(super) field: String,
    /// Identifiers and file names of the image; empty if the file does not have them.
    pub(super) images: Vec<String>,
    /// Size of the image, pixels, if the file has it.
    pub(super) size: Option<[u32; 2]>,
    /// x, y and confidence of each point; empty for nobody; an error says what is wrong.
    pub(super) points: Result<Vec<[f64; 3]>, String>,
    /// COCO's outline, if there is one.
    pub(super) segmentation: Option<Value>,
}

/// Image that entries are of.
#[derive(Debug, Clone, Default)]
struct Context {
    images: Vec<String>,
    size: Option<[u32; 2]>,
}

/// All people of a file; an error describes what was expected.
pub(super) fn entries(json: &Value) -> Result<Vec<Entry>, String> {
    let mut found = Vec::new();
    if collect(json, "", &Context::default(), &mut found) {
        return Ok(found);
    }
    let keys = match json {
        Value::Object(map) => map.keys().take(8).map(|key| format!("`{key}`")).collect(),
        _ => Vec::new(),
    };
    let has = if keys.is_empty() { String::new() } else { format!(", found {}", keys.join(", ")) };
    Err(format!(
        "expected OpenPose's `people`, COCO's list of results or `annotations`, MMPose's \
         `instance_info`, or MediaPipe's `landmarks`{has}"
    ))
}

/// Adds the people of a value; false if it is of no known form.
fn collect(value: &Value, field: &str, context: &Context, found: &mut Vec<Entry>) -> bool {
    match value {
        Value::Object(map) => collect_object(map, field, context, found),
        Value::Array(list) if list.is_empty() => true,
        Value::Array(list) if list[0].get("x").is_some() || is_points(&list[0]) => {
            found.push(entry(points(value, None), field, context));
            true
        }
        Value::Array(list) => {
            let name = if field.is_empty() { "results" } else { field };
            let mut any = false;
            for (at, value) in list.iter().enumerate() {
                let field = format!("{name}[{at}]");
                if collect(value, &field, context, found) {
                    any = true;
                } else {
                    found.push(entry(Err("not a person".into()), &field, context));
                }
            }
            any
        }
        _ => false,
    }
}

/// True for a list that starts with a number or `null`.
fn is_points(value: &Value) -> bool {
    value.as_array().is_some_and(|list| {
        (2..=4).contains(&list.len()) && list.iter().all(|x| x.is_number() || x.is_null())
    })
}

fn collect_object(
    map: &Map<String, Value>,
    field: &str,
    context: &Context,
    found: &mut Vec<Entry>,
) -> bool {
    let at =
        |name: &str| if field.is_empty() { name.to_owned() } else { format!("{field}.{name}") };
    let context = &within(map, context);
    if let Some(Value::Array(annotations)) = map.get("annotations") {
        let images = map.get("images").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
        for (index, annotation) in annotations.iter().enumerate() {
            let Some(fields) = annotation.as_object() else { continue };
            let id = annotation.get("image_id");
            let image = images.iter().find(|image| id.is_some() && image.get("id") == id);
            let context = match image.and_then(Value::as_object) {
                Some(image) => within(image, context),
                None => context.clone(),
            };
            collect_person(fields, &format!("annotations[{index}]"), &context, found);
        }
        return true;
    }
    if let Some(info) = map.get("instance_info") {
        return collect(info, &at("instance_info"), context, found);
    }
    for name in PEOPLE {
        match map.get(name) {
            Some(Value::Array(people)) => {
                for (index, person) in people.iter().enumerate() {
                    let field = format!("{}[{index}]", at(name));
                    match person.as_object() {
                        Some(fields) => collect_person(fields, &field, context, found),
                        None => found.push(entry(points(person, None), &field, context)),
                    }
                }
                return true;
            }
            Some(_) => {
                found.push(entry(Err("expected a list".into()), &at(name), context));
                return true;
            }
            None => {}
        }
    }
    if POINTS.iter().any(|name| map.contains_key(*name)) && !map.contains_key("landmark") {
        // Several people's landmarks are lists of lists of objects.
        let several = |list: &Vec<Value>| {
            list.first().and_then(|one| one.get(0)).is_some_and(|point| point.get("x").is_some())
        };
        match map.get("landmarks").and_then(Value::as_array).filter(|list| several(list)) {
            Some(people) => people.iter().enumerate().for_each(|(index, person)| {
                let field = format!("{}[{index}]", at("landmarks"));
                found.push(entry(points(person, None), &field, context));
            }),
            None => collect_person(map, field, context, found),
        }
        return true;
    }
    // An annotation without keypoints.
    if map.contains_key("segmentation") {
        collect_person(map, field, context, found);
        return true;
    }
    for name in LANDMARKS {
        if let Some(landmarks) = map.get(name) {
            return landmarks.is_null() || collect(landmarks, &at(name), context, found);
        }
    }
    // Values by the name of the image.
    let known: Vec<(&String, &Value)> = map
        .iter()
        .filter(|(_, value)| value.is_object() || value.as_array().is_some_and(|l| !l.is_empty()))
        .collect();
    !known.is_empty()
        && known.into_iter().fold(false, |any, (name, value)| {
            let images = vec![name.clone()];
            collect(value, &at(name), &Context { images, ..context.clone() }, found) || any
        })
}

/// The context with the image that an object names.
fn within(map: &Map<String, Value>, context: &Context) -> Context {
    let number = |names: [&str; 2]| {
        let value = names.iter().find_map(|name| map.get(*name))?;
        value.as_u64().and_then(|side| u32::try_from(side).ok()).filter(|&side| side > 0)
    };
    let size = number(["canvas_width", "width"]).zip(number(["canvas_height", "height"]));
    let mut images = context.images.clone();
    let paths = map.get("image_paths").and_then(|paths| paths.get(0));
    let names = IMAGES.iter().filter_map(|name| map.get(*name)).chain(paths);
    // In COCO's table of images `id` is the image's.
    let own = map.get("file_name").and(map.get("id"));
    for value in names.chain(own) {
        let name = match value {
            Value::String(text) => text.clone(),
            Value::Number(number) => number.to_string(),
            _ => continue,
        };
        if !images.contains(&name) {
            images.push(name);
        }
    }
    Context { images, size: size.map(|(w, h)| [w, h]).or(context.size) }
}

fn collect_person(
    map: &Map<String, Value>,
    field: &str,
    context: &Context,
    found: &mut Vec<Entry>,
) {
    let name = POINTS.iter().chain(&LANDMARKS).find(|name| map.contains_key(**name));
    let scores = SCORES.iter().find_map(|name| map.get(*name));
    let points = match name {
        Some(name) => points(&map[*name], scores),
        None => Ok(Vec::new()),
    };
    let field = format!("{field}.{}", name.unwrap_or(&POINTS[0]));
    let person = entry(points, field.trim_start_matches('.'), &within(map, context));
    found.push(Entry { segmentation: map.get("segmentation").cloned(), ..person });
}

fn entry(points: Result<Vec<[f64; 3]>, String>, field: &str, context: &Context) -> Entry {
    let Context { images, size } = context.clone();
    Entry { field: field.to_owned(), images, size, points, segmentation: None }
}

/// Points of a person in any of the forms: a list of numbers, of lists of numbers, of objects, or an
/// object of lists; `null` and an empty list are nobody.
fn points(value: &Value, scores: Option<&Value>) -> Result<Vec<[f64; 3]>, String> {
    let scores = match scores {
        Some(scores) => Some(numbers(flat(scores))?),
        None => None,
    };
    if let (Some(x), Some(y)) = (value.get("x"), value.get("y")) {
        let (x, y) = (numbers(x)?, numbers(y)?);
        let own = CONFIDENCE.iter().find_map(|name| value.get(*name));
        let scores = own.map(numbers).transpose()?;
        return Ok(rows(&x, &y, scores.as_deref()));
    }
    let list = match value {
        Value::Null => return Ok(Vec::new()),
        Value::Object(fields) => {
            let inner = LANDMARKS.iter().find_map(|name| fields.get(*name));
            return inner.map_or(Err("expected a list of numbers".into()), |v| points(v, None));
        }
        _ => flat(value).as_array().ok_or("expected a list of numbers")?,
    };
    match list.first() {
        None => Ok(Vec::new()),
        Some(Value::Object(_)) => {
            let known = |point: &&Value| CONFIDENCE.iter().any(|name| point.get(*name).is_some());
            let any = list.iter().any(|point| known(&point));
            let read = |point: &Value| {
                let number = |name: &str| point.get(name).and_then(Value::as_f64);
                let own = CONFIDENCE.iter().find_map(|name| number(name));
                // Zeros may be left out.
                let confidence = own.unwrap_or(if any { 0.0 } else { 1.0 });
                [number("x").unwrap_or(0.0), number("y").unwrap_or(0.0), confidence]
            };
            Ok(list.iter().map(read).collect())
        }
        Some(Value::Array(_)) => {
            let read = |(at, point): (usize, &Value)| {
                let row = numbers(point)?;
                let score = scores.as_ref().and_then(|scores| scores.get(at)).copied();
                match (row.as_slice(), score) {
                    (&[x, y, ..], Some(score)) => Ok([x, y, score]),
                    (&[x, y], None) => Ok([x, y, 1.0]),
                    (&[x, y, confidence] | &[x, y, _, confidence], None) => Ok([x, y, confidence]),
                    _ => Err(format!("point {at}: {} numbers, expected 2 to 4", row.len())),
                }
            };
            list.iter().enumerate().map(read).collect()
        }
        Some(_) => from_numbers(&numbers(flat(value))?, scores.as_deref()),
    }
}

/// Points of one list of numbers: threes, or pairs with confidences apart or none.
fn from_numbers(numbers: &[f64], scores: Option<&[f64]>) -> Result<Vec<[f64; 3]>, String> {
    let known = |points: usize| super::KeypointLayout::of_count(points).next().is_some();
    let (threes, rest) = numbers.as_chunks::<3>();
    let (pairs, odd) = numbers.as_chunks::<2>();
    let apart = scores.is_some_and(|scores| scores.len() == pairs.len());
    if odd.is_empty()
        && (apart || (!(rest.is_empty() && known(threes.len())) && known(pairs.len())))
    {
        let score = |at: usize| scores.filter(|_| apart).map_or(1.0, |scores| scores[at]);
        return Ok(pairs.iter().enumerate().map(|(at, &[x, y])| [x, y, score(at)]).collect());
    }
    if rest.is_empty() {
        return Ok(threes.to_vec());
    }
    Err(format!("{} numbers, expected x, y and confidence of each point", numbers.len()))
}

fn rows(x: &[f64], y: &[f64], scores: Option<&[f64]>) -> Vec<[f64; 3]> {
    let score = |at: usize| scores.map_or(1.0, |s| s.get(at).copied().unwrap_or(0.0));
    x.iter().zip(y).enumerate().map(|(at, (&x, &y))| [x, y, score(at)]).collect()
}

/// A list without axes of one entry around it.
fn flat(mut value: &Value) -> &Value {
    while let Some([inner @ Value::Array(list)]) = value.as_array().map(Vec::as_slice)
        && list.len() > 4
    {
        value = inner;
    }
    value
}

/// Numbers of a list; `null` is NaN.
fn numbers(value: &Value) -> Result<Vec<f64>, String> {
    let list = value.as_array().ok_or("expected a list of numbers")?;
    let number = |value: &Value| match value {
        Value::Null => Ok(f64::NAN),
        Value::Bool(seen) => Ok(f64::from(*seen)),
        _ => value.as_f64().ok_or_else(|| "expected a list of numbers".to_owned()),
    };
    list.iter().map(number).collect()
}
