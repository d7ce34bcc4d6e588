// The page of `cape view`.

import { openServer } from "./server.js";
import { start } from "./viewer.js";

start(openServer);
