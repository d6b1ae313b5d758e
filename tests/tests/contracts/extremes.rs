//! Every extreme on every level and thread count: bits agree, properties hold, and no error is worse than in
//! `tests/extremes/record.json`. `tests/extremes/REPORT.md` describes how both are written.

use std::collections::BTreeSet;

use streamsplat_tests::extremes::{cases, record};

fn check(group: &str) {
    let recorded = record::read();
    let cases = cases().into_iter().filter(|case| case.group == group);
    let mut complaints = Vec::new();
    let mut tried = 0;
    for case in cases {
        complaints.extend(record::complaints(&case, &recorded));
        tried += 1;
    }
    assert!(tried > 0, "no case in {group}");
    assert!(complaints.is_empty(), "{}", complaints.join("\n"));
}

macro_rules! groups {
    ($($test:ident: $group:literal;)*) => {
        $(#[test]
        fn $test() {
            check($group);
        })*

        #[test]
        fn every_case_is_tried_and_recorded_once() {
            let groups = BTreeSet::from([$($group),*]);
            let cases = cases();
            assert!(cases.iter().all(|case| groups.contains(case.group)));
            let keys: BTreeSet<String> = cases.iter().map(|case| case.key()).collect();
            assert_eq!(keys.len(), cases.len());
            assert!(keys.into_iter().eq(record::read().into_keys()));
        }
    };
}

groups! {
    attention_keeps_its_error_at_the_extremes: "Attention";
    norms_keep_their_error_at_the_extremes: "Norms";
    products_keep_their_error_where_terms_cancel: "Products";
    truncated_normals_keep_their_distribution: "Truncated normal";
    opacity_windows_stay_monotone_steps: "Opacity in time";
    time_of_any_length_gives_the_same_scene: "Time";
    splats_in_traps_are_drawn_as_defined: "Splats";
    bad_values_are_dropped_and_never_spread: "Values that are no numbers";
    images_of_any_kind_are_read_and_reconstructed: "Images";
    videos_that_break_off_keep_their_key_frames: "Videos";
}

#[test]
fn an_error_above_the_record_and_a_case_without_one_are_complaints() {
    let cases = cases();
    let case = cases.iter().find(|case| case.key() == "Norms: RmsNorm, values of 1e18").expect("a case");
    let mut recorded = record::read();
    assert!(record::complaints(case, &recorded).is_empty());
    let error = recorded.get_mut(&case.key()).expect("recorded");
    *error *= 0.9;
    assert!(record::complaints(case, &recorded)[0].contains("the error is"));
    recorded.remove(&case.key());
    assert!(record::complaints(case, &recorded)[0].contains("not in the record"));
}
