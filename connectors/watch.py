"""Following the slip events that rigs publish over MQTT."""

import asyncio
import logging
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from random import uniform
from secrets import token_hex

from connectors.broker import Broker
from connectors.events import Event, topic
from operators.errors import EndpointError, InputError

log = logging.getLogger("slipflow")

FIRST_RETRY = 0.1  # s
LAST_RETRY = 5.0  # s, up to which the back-off doubles


async def watch(
    url: str, site: str = "+", rig: str = "+", *, report: Callable[[str], object] = log.warning
) -> AsyncGenerator[Event]:
    """Give each event of the rigs that `site` and `rig` name, ``+`` standing for any, for ever.

    What is malformed is reported and left out. A lost connection is reported and made again, with back-off;
    around that events may come twice, with the same identifier, or be missed. If more than 1000 wait to be
    read, the oldest are dropped, which is reported. Close the generator when done (`contextlib.aclosing`).

    Raises:
        ParameterError: on a URL, a site or a rig that cannot be used.
        EndpointError: if the first connection fails.
    """
    from connectors.link import connect  # noqa: PLC0415 - aiomqtt takes 0.2 s to import

    broker = Broker.parse(url, "watch")
    topics = f"{topic('watch', site, rig, wildcard='+')}/+/event"
    identifier = f"slipflow-watch-{token_hex(4)}"
    retry, connected = FIRST_RETRY, False
    while True:
        try:
            link = await connect(broker, identifier)
            try:
                await link.listen(topics)
                if connected:
                    report(f"{broker}: connected again")
                retry, connected = FIRST_RETRY, True
                dropped = 0
                async with aclosing(link.incoming()) as incoming:
                    async for place, payload in incoming:
                        if link.dropped > dropped:
                            report(f"{broker}: {link.dropped - dropped} events dropped: they came too fast")
                            dropped = link.dropped
                        try:
                            event = Event.decode(payload, place)
                        except InputError as error:
                            report(f"left out: {error}")
                        else:
                            yield event
            finally:
                await link.leave()
        except EndpointError as error:
            if not connected:
                raise
            report(f"{error}, trying again")
            await asyncio.sleep(retry * uniform(0.5, 1))  # noqa: S311 - so that many do not come back at once
            retry = min(2 * retry, LAST_RETRY)
