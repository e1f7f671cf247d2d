"""On the path of a server that tests start: its jobs write reports without their pictures, which the page lacks too."""

import feeddrive.report.page
import no_pictures

feeddrive.report.page.svg = no_pictures.empty
