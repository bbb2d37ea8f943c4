/** Files of a model from the network. */

/**
 * Fetches files at the same time.
 *
 * @param urls - addresses of the files.
 * @param onprogress - called with the fraction of all bytes that have arrived, if the server states their number.
 * @returns the contents of each file.
 * @throws Error that names the first file that cannot be fetched.
 */
export async function fetchAll(urls: URL[], onprogress: (fraction: number) => void): Promise<ArrayBuffer[]> {
  const responses = await Promise.all(urls.map(open));
  const total = responses.reduce((sum, { headers }) => sum + Number(headers.get("Content-Length") ?? NaN), 0);
  let arrived = 0;
  const contents = await Promise.all(
    responses.map(async (response) => {
      const counted = new TransformStream<Uint8Array, Uint8Array>({
        transform(part, controller) {
          arrived += part.length;
          // A server that compresses states fewer bytes than arrive here.
          if (total) onprogress(Math.min(arrived / total, 1));
          controller.enqueue(part);
        },
      });
      return new Response(response.body?.pipeThrough(counted)).arrayBuffer();
    }),
  );
  onprogress(1);
  return contents;
}

async function open(url: URL): Promise<Response> {
  let why: string;
  try {
    const response = await fetch(url);
    if (response.ok) return response;
    why = `status ${response.status}`;
  } catch (error) {
    why = (error as Error).message;
  }
  throw new Error(`cannot fetch ${url.pathname} (${why})`);
}
