#![no_main]

streamsplat_fuzz::target!("y4m");
