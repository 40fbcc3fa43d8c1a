"""What all panels of the tab share."""


class RadiositySidebar:
    """Where a panel is shown."""

    bl_space_type = 'VIEW_3D'
    bl_region_type = 'UI'
    bl_category = "Radiosity"


class RadiositySubPanel(RadiositySidebar):
    """A part below the main panel, grayed out while a bake runs."""

    bl_parent_id = "VIEW3D_PT_radiosity"
    bl_options = {'DEFAULT_CLOSED'}

    def prepared_layout(self, context):
        """Layout with labels to the left, without animation dots."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.enabled = not context.window_manager.radiosity.is_running
        return layout
