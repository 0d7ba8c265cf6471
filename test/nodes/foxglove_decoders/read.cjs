// Subscribes to all topics and decodes messages until each topic named has one; prints JSON.
// node read.cjs ADDRESS TOPIC...
const { FoxgloveClient } = require('@foxglove/ws-protocol');
const { parse } = require('@foxglove/rosmsg');
const { MessageReader } = require('@foxglove/rosmsg2-serialization');
const WebSocket = require('ws');

const [, , address, ...wanted] = process.argv;
const protocols = ['foxglove.sdk.v1', FoxgloveClient.SUPPORTED_SUBPROTOCOL];
const client = new FoxgloveClient({ ws: new WebSocket(address, protocols) });
const readers = new Map();
const topics = {};

function plain(key, value) {
  if (ArrayBuffer.isView(value)) return Array.from(value, (x) => (Number.isFinite(x) ? x : 'inf'));
  return typeof value === 'bigint' ? Number(value) : value;
}

let finished = false;

function finish(error) {
  if (finished) return;
  finished = true;
  const said = { topics, error, missing: wanted.filter((t) => !topics[t]) };
  process.stdout.write(JSON.stringify(said, plain), () => process.exit(0)); // once it is read
}

client.on('error', (error) => finish(String(error)));
client.on('advertise', (channels) => {
  for (const channel of channels) {
    const reader = new MessageReader(parse(channel.schema, { ros2: true }));
    readers.set(client.subscribe(channel.id), { channel, reader });
  }
});
client.on('message', ({ subscriptionId, data }) => {
  const { channel, reader } = readers.get(subscriptionId);
  topics[channel.topic] = { type: channel.schemaName, message: reader.readMessage(data) };
  if (wanted.every((topic) => topics[topic])) finish('');
});
setTimeout(() => finish('not within 100 s'), 100000);
