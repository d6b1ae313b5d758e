//! Comparison with Embree and with testing every box.

use safetensors::SafeTensors;

use super::*;

fn fixture() -> Vec<u8> {
    let root = std::env::var_os("STREAMSPLAT_FIXTURES")
        .map_or_else(|| std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures"), std::path::PathBuf::from);
    std::fs::read(root.join("space/embree.safetensors")).expect("the fixture is there")
}

fn vectors(file: &SafeTensors<'_>, name: &str) -> Vec<[f32; 3]> {
    let data = file.tensor(name).expect("in the fixture").data();
    let values: Vec<f32> = data.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    values.chunks_exact(3).map(|v| v.try_into().unwrap()).collect()
}

fn boxes(file: &SafeTensors<'_>) -> Vec<Bounds> {
    vectors(file, "box").chunks_exact(2).map(|c| Bounds { least: c[0], greatest: c[1] }).collect()
}

fn numbered(boxes: &[Bounds]) -> impl Iterator<Item = (u32, Bounds)> + '_ {
    (0..).zip(boxes.iter().copied())
}

#[test]
fn rays_hit_the_boxes_that_embree_says_they_hit() {
    let bytes = fixture();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let tree = Tree::new(numbered(&boxes(&file)));
    let (origins, directions) = (vectors(&file, "origin"), vectors(&file, "direction"));
    let data = file.tensor("hit").unwrap().data();
    let hits: Vec<u32> = data.chunks_exact(4).map(|b| u32::from_le_bytes(b.try_into().unwrap())).collect();
    let mut expected = vec![Vec::new(); origins.len()];
    for hit in hits.chunks_exact(2) {
        expected[hit[0] as usize].push(hit[1]);
    }
    assert!(expected.iter().map(Vec::len).sum::<usize>() > 300);
    for (ray, expected) in expected.iter().enumerate() {
        assert_eq!(&tree.along_ray(origins[ray], directions[ray]), expected, "ray {ray}");
    }
}

#[test]
fn every_answer_is_that_of_looking_at_every_box() {
    let bytes = fixture();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let boxes = boxes(&file);
    let tree = Tree::new(numbered(&boxes));
    let all = |wanted: &dyn Fn(&Bounds) -> bool| -> Vec<u32> {
        numbered(&boxes).filter(|(_, b)| wanted(b)).map(|(i, _)| i).collect()
    };
    let (origins, directions) = (vectors(&file, "origin"), vectors(&file, "direction"));
    for (&origin, &direction) in origins.iter().zip(&directions) {
        assert_eq!(tree.along_ray(origin, direction), all(&|b| b.meets_ray(origin, direction)));
        let around = Bounds { least: origin.map(|v| v - 0.2), greatest: origin.map(|v| v + 0.1) };
        assert_eq!(tree.overlapping(&around), all(&|b| b.overlaps(&around)));
        let sides = [
            HalfSpace { normal: direction, offset: -0.5 },
            HalfSpace { normal: [1.0, 0.0, 0.5], offset: -0.25 },
            HalfSpace { normal: [-1.0, 0.3, 0.5], offset: 0.0 },
        ];
        assert_eq!(tree.inside(&sides), all(&|b| sides.iter().all(|s| b.reaches(s))));
    }
}

#[test]
fn a_point_is_in_the_nearest_footprint_that_holds_it() {
    let snapshot = Snapshot {
        index: vec![0, 1, 2, 3],
        mean: vec![[0.0, 0.0, 1.0], [0.2, 0.0, 1.0], [0.2, 0.0, 1.0], [0.0, 0.0, f32::NAN]],
        scale: vec![[0.1; 3], [0.2; 3], [0.2; 3], [1.0; 3]],
        opacity: vec![1.0, 0.9, 0.9, 1.0],
        rgb: vec![[0.0; 3]; 4],
        dropped: 0,
    };
    let tree = Tree::of(&snapshot);
    assert_eq!(tree.len(), 3);
    assert_eq!(tree.nearest_footprint(&snapshot, [0.01, 0.0, 1.0]), Some(0));
    assert_eq!(tree.nearest_footprint(&snapshot, [0.15, 0.0, 1.0]), Some(1));
    assert_eq!(tree.nearest_footprint(&snapshot, [5.0, 0.0, 1.0]), None);
    // In the corner of a box, but beyond the ellipsoid in it.
    assert_eq!(tree.nearest_footprint(&snapshot, [-0.33, 0.33, 1.33]), None);
}

#[test]
fn empty_trees_and_bad_numbers_find_nothing() {
    let tree = Tree::new([]);
    assert!(tree.is_empty() && tree.along_ray([0.0; 3], [0.0, 0.0, 1.0]).is_empty() && tree.inside(&[]).is_empty());
    let one = Bounds { least: [0.0; 3], greatest: [1.0; 3] };
    let bad = Bounds { least: [f32::NAN; 3], greatest: [1.0; 3] };
    let tree = Tree::new([(7, one), (8, bad), (9, Bounds { least: [2.0; 3], greatest: [1.0; 3] })]);
    assert_eq!(tree.along_ray([0.5, 0.5, -1.0], [0.0, 0.0, 1.0]), [7]);
    assert!(tree.along_ray([0.5, 0.5, 2.0], [0.0, 0.0, 1.0]).is_empty());
    assert!(tree.along_ray([f32::NAN; 3], [0.0, 0.0, 1.0]).is_empty());
    assert!(tree.along_ray([0.5; 3], [0.0; 3]).is_empty());
    assert_eq!(Bounds::of_gaussian([0.0; 3], [1.0; 3], 0.003), None);
}
