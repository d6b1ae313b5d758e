//! The canonical set over a few key frames made by hand.

use std::sync::Arc;

use streamsplat_model::{StaticGaussian, StaticGaussians};

use super::canonical::{Advance, CanonicalSet, Layer, Layers, Step};
use super::fuse::{Meeting, fuse};
use super::identities::Identities;
use super::keep::{Change, Keeps};
use super::matching::Lattice;
use super::reconstructor::Motion;
use super::{Fusion, Handover, Merge, Record, Reference};

/// Gaussians at these places, on an image wide enough that two of them are far apart.
fn frame(places: &[[f32; 3]]) -> Arc<StaticGaussians> {
    let at = |&position| StaticGaussian {
        position,
        scale: [0.01; 2],
        opacity: 0.8,
        rgb: [0.5; 3],
        ..StaticGaussian::default()
    };
    Arc::new(places.iter().map(at).collect())
}

fn moving(velocity: &[[f32; 3]]) -> Motion {
    (velocity.to_vec(), vec![[0.0, 0.5]; velocity.len()])
}

struct Stream {
    set: CanonicalSet,
    gaussians: Arc<StaticGaussians>,
    max_age: u32,
    lifted: bool,
    /// Number of a frame's Gaussians, after the model's own, that are seen along edges.
    outline: usize,
    /// Number of those at the end that are behind others.
    behind: usize,
    /// What happens to each Gaussian in the next interval.
    kept: Option<Keeps>,
}

impl Stream {
    fn new(places: &[[f32; 3]], max_age: u32) -> (Self, Advance) {
        let gaussians = frame(places);
        let (set, advance) = CanonicalSet::first(&gaussians, Layers::of_cells(places.len()));
        (Self { set, gaussians, max_age, lifted: false, outline: 0, behind: 0, kept: None }, advance)
    }

    /// Pushes the next frame, with the velocities of the Gaussians of the one before.
    fn push(&mut self, places: &[[f32; 3]], forward: &[[f32; 3]], length: f64) -> Advance {
        assert_eq!(forward.len(), self.gaussians.position.len());
        let gaussians = frame(places);
        let step = Step {
            gaussians: &gaussians,
            layers: Layers {
                cells: places.len() - self.outline - self.behind,
                outline: places.len() - self.behind,
                behind: places.len(),
            },
            forward: &moving(forward),
            backward: &moving(&vec![[0.0; 3]; places.len()]),
            length,
            lifted: self.lifted,
            image: [100, 100],
            fusion: Fusion::Persistent,
            max_age: self.max_age,
            kept: self.kept.as_ref(),
        };
        let (set, advance) = self.set.advance(&step);
        (self.set, self.gaussians) = (set, gaussians);
        advance
    }
}

/// Two dozen Gaussians in the lower half, so that the lattice's cells are small.
fn floor() -> Vec<[f32; 3]> {
    (0..100).map(|i| [(i % 10) as f32 * 0.2 - 0.9, 0.5, -0.05 - (i / 10) as f32 * 0.09]).collect()
}

const STILL: [f32; 3] = [0.0; 3];

#[test]
fn what_nothing_continues_keeps_its_pace_and_halves_in_every_interval() {
    let mut start = floor();
    start.push([-0.5, 0.5, 0.8]);
    let (mut stream, first) = Stream::new(&start, 8);
    assert_eq!(first.gaussians.len(), 101);
    let lonely = first.gaussians.identity[100];
    let mut velocity = vec![STILL; 101];
    velocity[100] = [0.1, 0.0, 0.0];
    // Two seconds, then one, then four: 0.05 units per second.
    let mut found: Vec<Record> = Vec::new();
    for (length, forward) in [(2.0, velocity), (1.0, vec![STILL; 100]), (4.0, vec![STILL; 100])] {
        let advance = stream.push(&floor(), &forward, length);
        found.push(advance.gaussians.iter().find(|r| r.identity == lonely).expect("it lives"));
        assert!(advance.merges.is_empty());
    }
    let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-5, "{a} {b}");
    for (record, [x, v]) in found.iter().zip([[-0.5, 0.1], [-0.4, 0.05], [-0.35, 0.2]]) {
        close(record.mean[0], x);
        close(record.velocity[0], v);
        assert_eq!(
            (record.handover, record.reference, record.frame, record.birth),
            (Handover::None, Reference::Start, 0, 0)
        );
    }
    // Forward through its own interval without fading (γ₀ = 0), then halved in each.
    close(found[0].opacity_at(1.0), 0.8);
    close(found[1].opacity_at(0.0), 0.8);
    close(found[1].opacity_at(1.0), 0.4);
    close(found[2].opacity_at(0.0), 0.4);
    close(found[2].opacity_at(1.0), 0.2);
    assert_eq!(found[1].mean[0].to_bits(), found[0].position_at(1.0)[0].to_bits());
    assert_eq!(found[2].opacity.to_bits(), found[1].opacity_at(1.0).to_bits());
}

#[test]
fn a_survivor_keeps_the_colour_it_had_at_the_key_frame() {
    let rate = [0.3, -0.2, 0.0];
    let mut old = [Record { rgb: [0.1, 0.7, 0.5], rgb_rate: rate, opacity: 0.8, ..Record::default() }];
    let lattice = Lattice::new(0, [100, 100]);
    let meeting = Meeting { frame: 1, lattice, layers: [&[Layer::Own], &[]], lifted: false, max_age: 8 };
    let fused = fuse(meeting, &mut old, &mut [], &mut Identities::from(1));
    let [survivor] = fused.survivors[..] else { panic!("expected one survivor, found {}", fused.survivors.len()) };
    assert_eq!(survivor.rgb_rate, [0.0; 3]);
    for t in [0.0, 0.5, 1.0] {
        assert_eq!(survivor.rgb_at(t).map(f32::to_bits), old[0].rgb_at(1.0).map(f32::to_bits));
    }
}

#[test]
fn what_is_too_old_fades_out_and_goes() {
    for max_age in [0, 1, 3] {
        let mut start = floor();
        start.push([-0.5, 0.5, 0.8]);
        let (mut stream, first) = Stream::new(&start, max_age);
        let lonely = first.gaussians.identity[100];
        let mut ages = Vec::new();
        for k in 0..6 {
            let forward = vec![STILL; if k == 0 { 101 } else { 100 }];
            let advance = stream.push(&floor(), &forward, 1.0);
            if let Some(record) = advance.gaussians.iter().find(|r| r.identity == lonely) {
                ages.push(record.handover);
            }
        }
        // Seen in interval k + 1 at age k; the last one fades out.
        assert_eq!(ages.len() as u32, max_age + 1);
        assert_eq!(ages.last(), Some(&Handover::Leaves));
        assert!(ages[..max_age as usize].iter().all(|h| *h == Handover::None));
    }
}

#[test]
fn identities_pass_on_emerge_and_merge() {
    // Two points that run into one place, and a third that appears.
    let mut start = floor();
    start.extend([[-0.5, 0.5, 0.5], [-0.3, 0.5, 0.5]]);
    let (mut stream, first) = Stream::new(&start, 8);
    let [left, right] = [first.gaussians.identity[100], first.gaussians.identity[101]];
    let mut velocity = vec![STILL; 102];
    (velocity[100][0], velocity[101][0]) = (0.1, -0.1);
    let mut next = floor();
    next.extend([[-0.41, 0.5, 0.5], [0.7, 0.5, 0.9]]);
    let advance = stream.push(&next, &velocity, 1.0);
    let ends: Vec<Record> = advance.gaussians.iter().filter(|r| r.reference == Reference::End).collect();
    assert_eq!(ends.len(), 102);
    assert!(ends.iter().all(|r| r.handover == Handover::Arrives && r.frame == 1));
    assert!(ends[..100].iter().zip(&first.gaussians.identity).all(|(r, i)| r.identity == *i && r.birth == 0));
    // In binary32 both are 0.01 from the new one; the nearer one passes its identity on, the other ends in it.
    let heir = ends[100].identity;
    assert!(heir == left || heir == right);
    assert_eq!(advance.merges, [Merge { identity: if heir == left { right } else { left }, into: heir }]);
    assert_eq!((ends[101].identity, ends[101].birth), (102, 1));
    // The tracked point stays where the motion took it, not where the lattice put the Gaussian.
    let carried = ends[100].mean[0] + ends[100].offset[0];
    assert!((carried + 0.4).abs() < 1e-6, "{carried}");
}

#[test]
fn identities_pass_on_to_a_frame_that_is_lifted_and_take_its_depth() {
    let start = floor();
    let far: Vec<[f32; 3]> = start.iter().map(|[x, _, z]| [*x, 0.1, *z]).collect();
    for lifted in [false, true] {
        let (stream, first) = Stream::new(&start, 8);
        let mut stream = Stream { lifted, ..stream };
        let advance = stream.push(&far, &vec![STILL; start.len()], 1.0);
        let ends: Vec<Record> = advance.gaussians.iter().filter(|r| r.reference == Reference::End).collect();
        let passed_on = ends.iter().zip(&first.gaussians.identity).filter(|(r, i)| r.identity == **i).count();
        assert_eq!(passed_on, if lifted { start.len() } else { 0 });
        assert!(ends.iter().all(|r| r.offset == [0.0; 3]));
    }
}

#[test]
fn identities_stay_with_their_places_when_the_first_frame_is_lifted() {
    // Two details, then the lift adds one along an edge and one behind, and leaves out the first detail.
    let front = floor();
    let (cells, details) = (front.len(), [[0.25, 0.6, -0.5], [0.5, 0.6, -0.5]]);
    let flat: Vec<[f32; 3]> = front.iter().copied().chain(details).collect();
    let (set, first) = CanonicalSet::first(&frame(&flat), Layers::of_cells(cells));
    let [x, _, z] = details[1];
    let added = [[0.25, 0.9, -0.5], [0.5, 0.1, -0.5], [x, 0.95, z]];
    let lifted: Vec<[f32; 3]> = front.iter().map(|[x, _, z]| [*x, 0.8, *z]).chain(added).collect();
    let layers = Layers { cells, outline: cells + 1, behind: cells + 2 };
    let set = set.lifted(&frame(&lifted), layers);
    let identities: Vec<u64> = set.current.iter().map(|current| current.identity).collect();
    assert_eq!(identities[..cells], first.gaussians.identity[..cells]);
    let of_details = &first.gaussians.identity[cells..];
    assert_eq!(identities[cells + 2], of_details[1]);
    assert!(identities[cells..cells + 2].iter().all(|identity| !first.gaussians.identity.contains(identity)));
    assert_eq!(set.identities.next(), identities[cells + 1] + 1);
}

#[test]
fn what_stands_behind_others_meets_its_like_and_is_not_kept() {
    // Ten of the floor, and as many behind these; then there is none behind the last one any more.
    let front = floor();
    let places = |behind: usize| -> Vec<[f32; 3]> {
        front.iter().copied().chain(front[..behind].iter().map(|[x, _, z]| [*x, 0.2, *z])).collect()
    };
    let layers = Layers { behind: front.len() + 10, ..Layers::of_cells(front.len()) };
    let (set, first) = CanonicalSet::first(&frame(&places(10)), layers);
    let gaussians = frame(&places(10));
    let mut stream = Stream { set, gaussians, max_age: 8, lifted: true, outline: 0, behind: 9, kept: None };
    let advance = stream.push(&places(9), &[STILL; 110], 1.0);
    let ends: Vec<Record> = advance.gaussians.iter().filter(|r| r.reference == Reference::End).collect();
    let identities: Vec<u64> = ends.iter().map(|r| r.identity).collect();
    assert_eq!(identities, first.gaussians.identity[..109]);
    let lonely = advance.gaussians.iter().find(|r| r.identity == first.gaussians.identity[109]).expect("it lives");
    assert_eq!(lonely.handover, Handover::Leaves);
    assert!(advance.merges.is_empty() && stream.set.survivors.is_empty());
}

#[test]
fn what_is_seen_along_edges_meets_what_is_seen_and_is_not_kept() {
    // One of the floor is followed by one along an edge; another one along an edge disappears.
    let front = floor();
    let [last, away] = [front[front.len() - 1], [0.0, 0.5, 5.0]];
    let start: Vec<[f32; 3]> = front.iter().copied().chain([away]).collect();
    let layers = Layers { cells: front.len(), outline: front.len() + 1, behind: front.len() + 1 };
    let (set, first) = CanonicalSet::first(&frame(&start), layers);
    let mut stream =
        Stream { set, gaussians: frame(&start), max_age: 8, lifted: true, outline: 1, behind: 0, kept: None };
    let end: Vec<[f32; 3]> = front[..front.len() - 1].iter().copied().chain([last]).collect();
    let advance = stream.push(&end, &vec![STILL; start.len()], 1.0);
    let ends: Vec<u64> =
        advance.gaussians.iter().filter(|r| r.reference == Reference::End).map(|r| r.identity).collect();
    assert_eq!(ends, first.gaussians.identity[..front.len()]);
    assert!(stream.set.survivors.is_empty());
}

#[test]
fn a_kept_gaussian_is_one_record_without_motion_or_fading() {
    let (mut stream, first) = Stream::new(&floor(), 8);
    let changes: Vec<Change> = (0..100).map(|cell| if cell % 2 == 0 { Change::None } else { Change::All }).collect();
    stream.kept = Some(Keeps::new(changes, 100));
    for interval in 0..3 {
        let advance = stream.push(&floor(), &[[0.001, 0.0, 0.0]; 100], 1.0);
        let kept: Vec<Record> = advance.gaussians.iter().skip(advance.kept.start).take(advance.kept.len()).collect();
        assert_eq!(kept.len(), 50, "interval {interval}");
        for record in &kept {
            let same =
                |r: &Record| (r.handover, r.reference, r.velocity) == (Handover::None, Reference::Start, [0.0; 3]);
            assert!(same(record) && record.opacity_at(0.5) == record.opacity);
        }
        let before: Vec<u64> = first.gaussians.identity.iter().copied().step_by(2).collect();
        assert_eq!(kept.iter().map(|record| record.identity).collect::<Vec<_>>(), before);
        // The others leave and arrive under their own identities.
        assert_eq!(advance.gaussians.len(), 150);
        let arriving = advance.gaussians.iter().filter(|record| record.reference == Reference::End);
        let others: Vec<u64> = first.gaussians.identity.iter().copied().skip(1).step_by(2).collect();
        assert_eq!(arriving.map(|record| record.identity).collect::<Vec<_>>(), others);
        assert!(advance.merges.is_empty() && stream.set.survivors.is_empty());
        // Drawing order over the key frame: kept ones, then those that arrived.
        assert!(stream.set.current[..50].iter().all(|current| current.cell % 2 == 0));
    }
    // All of them remain when nothing is kept any more.
    stream.kept = None;
    let advance = stream.push(&floor(), &[STILL; 100], 1.0);
    assert!(advance.kept.is_empty());
    assert_eq!(advance.gaussians.len(), 200);
}
