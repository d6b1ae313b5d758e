#![no_main]

streamsplat_fuzz::target!("spacetime");
