#![no_main]

streamsplat_fuzz::target!("splat_records");
