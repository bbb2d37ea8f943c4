/** The worker in which a model computes. */

import { Host } from "./host.js";

const host = new Host((reply, transfer) => self.postMessage(reply, { transfer }));
self.onmessage = ({ data }) => void host.handle(data);
