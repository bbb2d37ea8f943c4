"use strict";
// Connections to the server of the page: sound to frames, as docs/serving.md describes it, or frames alone.

const RETRY = 2; // seconds until the page connects again

function addressOf(path) {
  const address = new URL(path, location.href);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  address.search = address.hash = "";
  return address;
}

// Sound goes out and frames come in.
class Conversation {
  // Resolves when the server has answered with its facts, and throws an error with a message for people.
  static async open(token, asked) {
    const address = addressOf("v1/stream");
    if (token) address.searchParams.set("token", token);
    const conversation = new Conversation(new WebSocket(address));
    try {
      await conversation.greet(asked);
    } catch (error) {
      throw conversation.isAccepted ? error : new Error(await Conversation.refusal(token));
    }
    return conversation;
  }

  // A browser does not tell why a WebSocket was refused; the same address answers a plain request with the reason.
  static async refusal(token) {
    try {
      const headers = token ? { Authorization: `Bearer ${token}` } : {};
      const answer = await fetch("v1/stream", { headers, cache: "no-store" });
      if (answer.status === 426) return "The stream was refused; try again.";
      const text = (await answer.json()).error;
      return `Refused (${answer.status}): ${text}.`;
    } catch {
      return "The service does not answer.";
    }
  }

  constructor(socket) {
    this.socket = socket;
    this.onframes = this.onclose = () => {};
  }

  greet(asked) {
    return new Promise((resolve, reject) => {
      const { socket } = this;
      socket.onopen = () => { this.isAccepted = true; socket.send(JSON.stringify(asked)); };
      socket.onmessage = ({ data }) => {
        const message = JSON.parse(data);
        if (message.error) this.error = message.error;
        else if (message.frames) this.onframes(message.first, message.frames);
        else if (message.fps) resolve(this.facts = message);
      };
      socket.onclose = ({ code }) => {
        this.isClosed = true;
        const reason = this.error || (code === 1000 ? null : `the connection was lost (${code})`);
        reject(new Error(reason));
        this.onclose(reason);
      };
    });
  }

  // Bytes that are not sent yet.
  get waiting() { return this.socket.bufferedAmount; }

  send(message) {
    if (this.socket.readyState !== WebSocket.OPEN) return;
    this.socket.send(message instanceof ArrayBuffer ? message : JSON.stringify(message));
  }

  close() {
    this.onframes = this.onclose = () => {};
    this.socket.close(1000);
  }
}

// Frames come in, at the times at which they are to be shown; it connects again when the server is gone.
class Broadcast {
  constructor({ onfigure, onframes, onstate }) {
    Object.assign(this, { onfigure, onframes, onstate });
    this.connect();
  }

  connect() {
    const socket = new WebSocket(addressOf("page"));
    this.onstate(false);
    socket.onopen = () => this.onstate(true);
    socket.onmessage = ({ data }) => {
      const message = JSON.parse(data);
      if (message.figure) this.onfigure(message.figure);
      else this.onframes(message.first, message.frames);
    };
    socket.onclose = () => {
      this.onstate(false);
      setTimeout(() => this.connect(), 1000 * RETRY);
    };
  }
}
