#![no_main]

streamsplat_fuzz::target!("depth_map");
