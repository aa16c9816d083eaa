"""All pages and routes of the studio."""

from __future__ import annotations

from nicegui import app, run, ui
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from infrablend.errors import InfraBlendError
from infrablend.studio.open_studio import Session
from infrablend.studio.opened_run import OpenedRun
from infrablend.studio.pages import compare, found_page, layout, review, routes, sequence_page


def add_pages(session: Session) -> None:
    """Register the pages and routes for what is open."""
    layout.share_style()

    @app.get("/")
    def first_page() -> RedirectResponse:
        return RedirectResponse(next(iter(layout.pages_of(session))))

    if session.run is not None:
        _add_run_pages(session, session.run)
    detections = session.detections
    if detections is not None:
        found_page.add_routes(detections)

        @ui.page("/found")
        def detections_page(request: Request) -> None:
            with layout.page_frame(session, request, "/found", "Detections"):
                found_page.DetectionsPage(detections)

    _add_tune_page(session)

    comparison = session.comparison
    if comparison is not None:
        compare.add_routes(comparison)

        @ui.page("/compare")
        def compare_page(request: Request) -> None:
            with layout.page_frame(session, request, "/compare", "Compare"):
                compare.ComparePage(comparison)


def _add_run_pages(session: Session, opened: OpenedRun) -> None:
    routes.add_run_routes(opened)

    @ui.page("/review")
    def review_page(request: Request) -> None:
        with layout.page_frame(session, request, "/review", "Review"):
            review.ReviewPage(opened, request.query_params)

    @ui.page("/sequences")
    def sequences_page(request: Request) -> None:
        with layout.page_frame(session, request, "/sequences", "Sequences"):
            frame = request.query_params.get("frame", "")
            layout.when_read(opened, lambda: sequence_page.show_sequence(opened, frame))

    @ui.page("/losses")
    def losses_page(request: Request) -> None:
        with layout.page_frame(session, request, "/losses", "Lost labels"):
            layout.when_read(opened, lambda: review.show_losses(opened))

    further = session.request.results

    @app.get("/results/{report}/{number}")
    def result_picture(report: int, number: int) -> Response:
        from infrablend.studio.pages import results_page

        return results_page.picture(opened.layout.root, further, report, number)

    @ui.page("/results")
    def results_page(request: Request) -> None:
        from infrablend.studio.pages import results_page  # loads what the other pages do not need

        with layout.page_frame(session, request, "/results", "Results"):
            data = opened.record.get("data")
            results_page.build(
                opened.layout.root, str(data.get("root", "DATA")) if isinstance(data, dict) else "DATA", further
            )


def _add_tune_page(session: Session) -> None:
    pictures = routes.add_tune_routes(session.open_tuning)

    @ui.page("/tune")
    def tune_page(request: Request) -> None:
        with layout.page_frame(session, request, "/tune", "Tune"):
            place = ui.element("div")
            with place:
                ui.label("Reading the recipe and the backgrounds...").classes("faint").props("role=status")

            async def fill() -> None:
                try:
                    tuning = await run.io_bound(session.open_tuning)
                except InfraBlendError as error:
                    place.clear()
                    with place:
                        layout.show_error(error)
                    return
                from infrablend.studio.pages import tune

                place.clear()
                with place:
                    tune.TunePage(tuning, pictures, request.query_params)

            ui.timer(0.01, fill, once=True)
