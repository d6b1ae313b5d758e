#![no_main]

streamsplat_fuzz::target!("scene_index");
