// The player's worker.

import { answer } from "./work.js";

onmessage = answer;
